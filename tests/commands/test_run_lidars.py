"""Planar lidars go through `run`: CARMEN logs and bags of laser scans, with wheels as odometry."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.recordings import bag_path
from support.rooms import largest_error_m, slip, write_bag, write_carmen

import mqslam
from mqslam.commands.info import describe_lidar
from mqslam.commands.lidar_inputs import warn_of_idle
from mqslam.config import load_config, set_doppler_beta
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import ConfigError, DataError
from mqslam.formats.lidars import read_lidar
from mqslam.formats.maps.nav2_map import read_nav2_map
from mqslam.formats.tum import read_tum

PLANAR = Path(__file__).parents[3] / "shared" / "data" / "planar"
JUDGE = Path(__file__).parents[3] / "shared" / "tools" / "score_relations.py"


@pytest.fixture(scope="module")
def carmen(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Trajectory]:
    folder = tmp_path_factory.mktemp("carmen")
    truth = write_carmen(folder / "rooms.log")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["pytest"])  # the log quotes the command line, which may hold any words
        mqslam.run(folder / "rooms.log", folder / "out")
    return folder / "out", truth


def test_a_carmen_log_becomes_a_trajectory_far_better_than_its_wheels(carmen: tuple[Path, Trajectory]) -> None:
    out, truth = carmen
    assert largest_error_m(slip(truth), truth) > 1.0
    assert largest_error_m(read_tum(out / "trajectory.tum"), truth) < 0.1


def test_every_scan_has_a_pose_though_scans_at_rest_are_not_solved(carmen: tuple[Path, Trajectory]) -> None:
    out, truth = carmen
    np.testing.assert_array_equal(read_tum(out / "trajectory.tum").stamps_us, truth.stamps_us)


def test_counts_length_and_duration_of_a_run_agree_with_its_trajectory(
    carmen: tuple[Path, Trajectory],
) -> None:
    out, truth = carmen
    dataset = json.loads((out / "summary.json").read_text())["dataset"]
    assert dataset["revolutions"] < len(truth) == dataset["revolutions"] + dataset["left_out"]
    assert dataset["duration_s"] == pytest.approx(0.2 * len(truth))
    assert dataset["length_m"] == pytest.approx(read_tum(out / "trajectory.tum").length_m, abs=0.01)
    page = (out / "report.html").read_text()
    used = dataset["revolutions"]
    assert f"{used} scans (of {len(truth)}; the others are left out, since the lidar had hardly moved)" in page
    assert f"Distances count from scan to scan of the {used} that are used" in page
    facts = describe_lidar(read_lidar(out.parent / "rooms.log"))
    assert (facts["scans"], facts["duration_s"]) == (len(truth), dataset["duration_s"])


def test_a_run_of_rooms_leaves_all_files_and_judges_its_map_good(carmen: tuple[Path, Trajectory]) -> None:
    out, _ = carmen
    summary = json.loads((out / "summary.json").read_text())
    assert summary["verdict"]["status"] in ("pass", "warn")
    assert summary["factors"]["loop"] > 0
    for name in ("map.pgm", "map.yaml", "map.ply", "graph.g2o", "covariances.csv", "report.html", "run.log"):
        assert (out / name).stat().st_size > 0


def test_nothing_that_a_lidars_run_leaves_speaks_of_a_radar(carmen: tuple[Path, Trajectory]) -> None:
    for name in ("run.log", "report.html", "summary.json"):
        text = (carmen[0] / name).read_text().lower().replace("radar_topic", "")  # the page lists every setting by its name
        assert "radar" not in text
    assert "Doppler" not in (carmen[0] / "run.log").read_text()


def test_a_lidars_run_with_the_settings_of_an_earlier_one_warns_of_none(carmen: tuple[Path, Trajectory]) -> None:
    earlier = load_config(carmen[0] / "config.yaml")
    assert warn_of_idle(earlier) == []
    (warning,) = warn_of_idle(set_doppler_beta(earlier, 0.05))
    assert warning.endswith("settings of radars have no effect: sensor.doppler_beta")


def test_motions_state_how_well_they_are_known_and_are_not_tied_along_the_path(carmen: tuple[Path, Trajectory]) -> None:
    out, truth = carmen
    rows = np.genfromtxt(out / "measurements.csv", delimiter=",", names=True, usecols=range(11))
    times = np.array([rows["t0"], rows["t1"]]) * 1e6
    begin, end = (truth.at(truth.stamps_us[0] + np.round(stamps).astype(np.int64)) for stamps in times)
    off = np.column_stack([rows["dx"], rows["dy"], rows["dyaw"]]) - se2.wrapped_between(begin, end)
    xx, xy, xt, yy, yt, tt = (rows[f"cov_{name}"] for name in ("xx", "xy", "xyaw", "yy", "yyaw", "yawyaw"))
    covariances = np.moveaxis(np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]]), 2, 0)
    assert 0.3 < np.mean(se2.normalise(off, covariances)) / 3.0 < 3.0
    runtime_s = json.loads((out / "summary.json").read_text())["runtime_s"]
    assert runtime_s["along"] < 0.01 * runtime_s["windows"]


def test_the_map_of_rooms_is_free_along_the_way_and_occupied_at_walls(carmen: tuple[Path, Trajectory]) -> None:
    out, _ = carmen
    made, track = read_nav2_map(out / "map.yaml"), read_tum(out / "trajectory.tum")
    columns, rows = ((track.poses[:, :2] - made.origin[:2]) / made.resolution).astype(int).T
    assert np.mean(made.cells[rows, columns] == 0) > 0.95
    wall = np.arange(-1.5, 7.5, made.resolution)  # the outer wall on the right, which is 2 m to the right of the start
    columns, row = ((wall - made.origin[0]) / made.resolution).astype(int), int((-2.0 - made.origin[1]) / made.resolution)
    assert np.mean((made.cells[row - 1 : row + 2, columns] == 100).any(axis=0)) > 0.8


def test_a_bag_of_laser_scans_becomes_a_trajectory(tmp_path: Path) -> None:
    path = bag_path(tmp_path, "ros2")
    truth = write_bag(path, "ros2")
    mqslam.run(path, tmp_path / "out")
    assert largest_error_m(read_tum(tmp_path / "out" / "trajectory.tum"), truth) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("name", "most_m"), [("fr079", 0.06)])
def test_a_real_run_meets_its_verified_relations(tmp_path: Path, name: str, most_m: float) -> None:
    log, relations = PLANAR / f"{name}.log.gz", PLANAR / f"{name}.relations.gz"
    if not log.exists() or not JUDGE.exists():
        pytest.skip(f"no {log} or no {JUDGE}")
    mqslam.run(log, tmp_path / "out")
    command = [sys.executable, str(JUDGE), str(tmp_path / "out" / "trajectory.tum"), str(relations), "--json"]
    scored = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    assert scored["scored"] > 1600
    assert scored["metres"][0] < most_m


def test_a_part_of_a_lidars_recording_is_solved_by_itself(tmp_path: Path) -> None:
    truth = write_carmen(tmp_path / "rooms.log")
    result = mqslam.run(tmp_path / "rooms.log", tmp_path / "out", start_s=5.0, end_s=17.0)
    track = read_tum(tmp_path / "out" / "trajectory.tum")
    np.testing.assert_array_equal(track.stamps_us, truth.stamps_us[25:85])
    assert largest_error_m(track, truth) < 0.1
    assert any("from 5 s to 17 s are used" in line for line in (result.folder / "run.log").read_text().splitlines())


def test_poses_of_scans_serve_as_odometry_where_a_log_has_none(tmp_path: Path) -> None:
    truth, log = write_carmen(tmp_path / "rooms.log"), tmp_path / "scans.log"
    lines = (tmp_path / "rooms.log").read_text().splitlines(keepends=True)
    log.write_text("".join(line for line in lines if line.startswith("FLASER")))
    with_lines, alone = (mqslam.run(path, tmp_path / path.stem, end_s=12.0) for path in (tmp_path / "rooms.log", log))
    said = "the recording has no odometry besides the poses of its scans, which are used as odometry"
    assert any(said in warning for warning in alone.warnings) and not any(said in each for each in with_lines.warnings)
    np.testing.assert_array_equal(alone.read_trajectory().poses, with_lines.read_trajectory().poses)
    assert largest_error_m(alone.read_trajectory(), truth) < 0.1
    without = mqslam.run(log, tmp_path / "without", end_s=12.0, odometry="none")
    assert not any(said in warning for warning in without.warnings)


def test_a_stretch_at_rest_says_how_many_scans_are_left_out_and_what_to_do(tmp_path: Path) -> None:
    write_carmen(tmp_path / "rooms.log", slower=200)
    result = mqslam.run(tmp_path / "rooms.log", tmp_path / "out", end_s=4.0)
    assert result.summary["dataset"]["revolutions"] == 2 and result.summary["dataset"]["duration_s"] == pytest.approx(4.0)
    remedy = "since the lidar had hardly moved: give a recording, or a stretch of it, in which it moves farther"
    assert f"18 of 20 scans are left out, {remedy}" in result.warnings


def test_a_slow_robot_is_tracked_though_its_scans_move_seldom(tmp_path: Path) -> None:
    truth = write_carmen(tmp_path / "rooms.log", slower=8)
    mqslam.run(tmp_path / "rooms.log", tmp_path / "out", end_s=18.0)
    assert "lost" not in (tmp_path / "out" / "measurements.csv").read_text()
    track = read_tum(tmp_path / "out" / "trajectory.tum")
    np.testing.assert_array_equal(track.stamps_us, truth.stamps_us[:90])
    assert largest_error_m(track, truth) < 0.1


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"imu": "turns.csv"}, "leave out readings of a gyroscope"),
        ({"gnss": "fixes.csv", "frame": "vehicle"}, "leave out GNSS fixes and another frame than the lidar's"),
        ({"extrinsics": (1.0, 0.0, 0.0)}, "leave out extrinsics"),
        ({"range_resolution": 0.1}, "has no range bins; leave the range resolution out"),
        ({"start_s": 0.0, "end_s": 0.1}, "holds one scan; give times that hold more"),
    ],
)
def test_what_a_lidars_run_cannot_use_is_refused_by_name(tmp_path: Path, given: dict[str, Any], named: str) -> None:
    write_carmen(tmp_path / "rooms.log")
    with pytest.raises(ConfigError, match=named):
        mqslam.run(tmp_path / "rooms.log", tmp_path / "out", **given)


def test_a_stretch_in_which_a_lidar_sees_nothing_is_refused(tmp_path: Path) -> None:
    log, rng = tmp_path / "hall.log", np.random.default_rng(0)
    scans = [rng.uniform(3.0, 8.0, 180) if k < 20 else np.full(180, 81.83) for k in range(40)]  # 81.83 m: no return
    words = [" ".join(f"{metres:.2f}" for metres in scan) for scan in scans]
    poses = [f"{0.1 * k} 0 0 {0.1 * k} 0 0 {0.2 * k + 1000.0} host 0" for k in range(40)]
    log.write_text("".join(f"FLASER 180 {scan} {pose}\n" for scan, pose in zip(words, poses, strict=True)))
    for command in (mqslam.run, mqslam.compare, mqslam.audit):
        with pytest.raises(DataError, match=r"hall\.log: holds no return in 15 scans; give a recording, or a stretch of it"):
            command(log, tmp_path / "out", start_s=5.0)
    assert not (tmp_path / "out").exists()
