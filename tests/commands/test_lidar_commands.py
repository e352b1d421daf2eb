"""Commands on the recording of a planar lidar besides `run`: compare, localise, merge, batch, and factors for Python."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path

import gtsam
import numpy as np
import pytest
from support.recordings import write_oxford
from support.rooms import PERIOD_US, largest_error_m, write_carmen

import mqslam
from mqslam.core.trajectory import Trajectory
from mqslam.errors import ConfigError, DataError
from mqslam.formats.clouds import read_cloud
from mqslam.formats.lidars import read_lidar
from mqslam.formats.maps.keyframe_folder import read_keyframes
from mqslam.formats.maps.nav2_map import read_nav2_map
from mqslam.formats.tum import read_tum, write_tum

ROUND_S = 60.0  # the robot drives two rounds, each as long as this


@pytest.fixture(scope="module")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Trajectory]:
    """Returns the log of a drive, and its true poses."""
    log = tmp_path_factory.mktemp("rooms") / "rooms.log"
    return log, write_carmen(log)


@pytest.fixture(scope="module")
def rounds(rooms: tuple[Path, Trajectory], tmp_path_factory: pytest.TempPathFactory) -> Sequence[Path]:
    """Returns the results of two runs, one of each round."""
    folder = tmp_path_factory.mktemp("rounds")
    mqslam.run(rooms[0], folder / "first", end_s=ROUND_S)
    mqslam.run(rooms[0], folder / "second", start_s=ROUND_S)
    return folder / "first", folder / "second"


def test_front_ends_are_compared_on_the_same_scans_of_a_lidar(rooms: tuple[Path, Trajectory], tmp_path: Path) -> None:
    log, truth = rooms
    result = mqslam.compare(log, tmp_path / "out", end_s=ROUND_S, frontends="psi,kiss_icp,odometry")
    rows = {row["name"]: row for row in result.summary["rows"]}
    assert all(row["failure"] is None for row in rows.values())
    assert rows["odometry"]["verdict"] != "pass"
    for name in rows:
        assert len(read_tum(tmp_path / "out" / name / "trajectory.tum")) == ROUND_S * 1e6 / PERIOD_US
    assert largest_error_m(read_tum(tmp_path / "out" / "psi" / "trajectory.tum"), truth) < 0.1
    assert largest_error_m(read_tum(tmp_path / "out" / "odometry" / "odometry.tum"), truth) > 0.3
    assert "psi" in result.conclusion and result.report.stat().st_size > 0


def test_chained_motions_of_a_lidar_are_in_metres(rooms: tuple[Path, Trajectory], tmp_path: Path) -> None:
    log, truth = rooms
    mqslam.compare(log, tmp_path / "out", end_s=12.0, frontends="psi", odometry_only=True)
    assert largest_error_m(read_tum(tmp_path / "out" / "psi" / "odometry.tum"), truth) < 0.1


def test_a_lidar_finds_itself_in_the_map_of_an_earlier_round(
    rooms: tuple[Path, Trajectory], rounds: Sequence[Path], tmp_path: Path
) -> None:
    log, truth = rooms
    result = mqslam.localise(log, tmp_path / "out", map=rounds[0], start_s=ROUND_S)
    assert result.summary["share_on_map"] > 0.9
    track = read_tum(tmp_path / "out" / "trajectory.tum")
    np.testing.assert_array_equal(track.stamps_us, truth.stamps_us[300:])
    assert largest_error_m(track, truth, truth.poses[0]) < 0.1


def test_two_rounds_of_a_lidar_become_one_map(
    rooms: tuple[Path, Trajectory], rounds: Sequence[Path], tmp_path: Path
) -> None:
    merged = mqslam.merge(rounds, tmp_path / "out")
    assert merged.summary["links"]["count"] >= 5 and merged.summary["changes"] == []
    for track in merged.read_trajectories():
        assert largest_error_m(track, rooms[1], rooms[1].poses[0]) < 0.1
    own, both = (read_keyframes(folder).keyframes for folder in (rounds[0], tmp_path / "out"))
    assert own.unit_m == both.unit_m and len(both.recordings) == 2
    spread = [np.ptp(keyframes.poses[:, :2], axis=0) for keyframes in (own, both)]
    np.testing.assert_allclose(*spread, atol=0.3)
    assert (tmp_path / "out" / "report.html").stat().st_size > 0
    assert not any(read_cloud(folder / "map.ply").is_of_radar for folder in (rounds[0], tmp_path / "out"))
    made = read_nav2_map(tmp_path / "out" / "map.yaml")
    for track in merged.read_trajectories():
        columns, rows = ((track.poses[:, :2] - made.origin[:2]) / made.resolution).astype(int).T
        assert np.mean(made.cells[rows, columns] == 0) > 0.95
    assert set(np.unique(made.cells)) == {-1, 0, 100}


def test_maps_of_lidars_and_radars_are_not_mixed(rounds: Sequence[Path], tmp_path: Path) -> None:
    radar = tmp_path / "radar"
    (radar / "keyframes").mkdir(parents=True)
    for path in rounds[1].iterdir():
        if path.is_file():
            (radar / path.name).write_bytes(path.read_bytes())
    for path in (rounds[1] / "keyframes").iterdir():
        (radar / "keyframes" / path.name).write_bytes(path.read_bytes())
    index = json.loads((radar / "keyframes" / "index.json").read_text())
    assert index["recordings"][0].pop("unit_m") > 0.0
    (radar / "keyframes" / "index.json").write_text(json.dumps(index))
    rows = csv.DictReader((radar / "graph.csv").read_text().splitlines())
    solved = {int(row[end]) for row in rows for end in ("from_stamp_us", "to_stamp_us") if row[end]}
    track = read_tum(radar / "trajectory.tum")
    kept = np.isin(track.stamps_us, sorted(solved))
    write_tum(radar / "trajectory.tum", Trajectory(track.stamps_us[kept], track.poses[kept]))
    with pytest.raises(DataError, match="merge results of one kind of sensor"):
        mqslam.merge([rounds[0], radar], tmp_path / "out")


def test_a_radars_recording_is_not_looked_for_in_a_lidars_map(rounds: Sequence[Path], tmp_path: Path) -> None:
    drive = write_oxford(tmp_path / "drive", polar_scans=4)
    with pytest.raises(DataError, match=r"is a radar's recording, but .*first is not the map of a radar"):
        mqslam.localise(drive, tmp_path / "out", map=rounds[0])


def test_a_batch_runs_a_lidars_recording(rooms: tuple[Path, Trajectory], tmp_path: Path) -> None:
    short = [line for line in rooms[0].read_text().splitlines(keepends=True)][:120]
    (tmp_path / "short.log").write_text("".join(short))
    (tmp_path / "runs.yaml").write_text(
        "runs:\n  - data: short.log\n"
        "  - data: short.log\n    name: wheels\n    frontend: odometry\n"
        "    set: {sensor.range_offset_m: 0.1, detector.threshold: 60}\n"
    )
    result = mqslam.batch(tmp_path / "runs.yaml", tmp_path / "out")
    assert [run["failure"] for run in result.summary["runs"]] == [None, None]
    none = "the recording is a lidar's, on which settings of radars have no effect: "
    idle = f"{none}sensor.range_offset_m and detector.threshold"
    assert {run["name"]: idle in run["warnings"] for run in result.summary["runs"]} == {"short.log": False, "wheels": True}
    for name in ("short.log", "wheels"):
        assert len(read_tum(tmp_path / "out" / name / "trajectory.tum")) == 60
    audited = mqslam.audit(tmp_path / "short.log", tmp_path / "audit", config={"sensor": {"doppler_beta": 0.049}})
    assert audited.warnings == [f"{none}sensor.doppler_beta"]


def test_an_open_lidars_log_takes_the_method_in_memory_to_the_trajectory_of_a_run(
    rooms: tuple[Path, Trajectory], tmp_path: Path
) -> None:
    short = tmp_path / "short.log"
    short.write_text("".join(rooms[0].read_text().splitlines(keepends=True)[:120]))
    recording = mqslam.open_recording(short)
    solved = mqslam.Slam().run(recording, recording.odometry)
    track = mqslam.run(short, tmp_path / "out").read_trajectory()
    moved = np.isin(track.stamps_us, solved.optimised.stamps_us)
    assert 20 < len(solved.optimised) <= len(recording) == len(track)
    np.testing.assert_allclose(solved.optimised.poses, track.poses[moved], atol=1e-6)
    with pytest.raises(ConfigError, match="is a lidar's recording; leave out range_resolution and clockwise, which only "):
        mqslam.open_recording(short, None, 0.05, clockwise=True)


def test_factors_of_a_lidar_make_the_graph_of_a_run(rooms: tuple[Path, Trajectory], tmp_path: Path) -> None:
    log, truth = rooms
    short = tmp_path / "short.log"
    short.write_text("".join(log.read_text().splitlines(keepends=True)[:720]))
    factors = mqslam.psi_factors(short, odometry=read_lidar(short).odometry)
    values, graph = factors.make_initial(), gtsam.NonlinearFactorGraph()
    graph.push_back(gtsam.PriorFactorPose2(factors.scan_keys[0], gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)))
    for factor, _ in factors:
        graph.push_back(factor)
    values = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    loops = mqslam.loop_factors(factors.scans, values, factors.scan_keys, graph=graph, config=factors.config)
    assert len(loops) > 0
    refined = mqslam.refine(graph, values, factors.scans, factors.scan_keys, loops=loops, config=factors.config, rounds=1)
    poses = [refined.values.atPose2(key) for key in factors.scan_keys]
    track = Trajectory(factors.scans.stamps_us, np.array([[pose.x(), pose.y(), pose.theta()] for pose in poses]))
    assert largest_error_m(track, truth) < 0.1
    graph.push_back(gtsam.PoseTranslationPrior2D(factors.scan_keys[0], gtsam.Pose2(), gtsam.noiseModel.Unit.Create(2)))
    with pytest.raises(ConfigError, match="give a graph of BetweenFactorPose2 and PriorFactorPose2"):
        mqslam.loop_factors(factors.scans, values, factors.scan_keys, graph=graph, config=factors.config)
