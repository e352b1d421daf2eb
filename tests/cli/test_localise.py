"""`mqslam localise` from the command line: what it writes, what it says, and what it refuses."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from support.commands import mqslam, parse_strict_json
from support.parameters import mostly_slow
from support.reported import find_faults

import mqslam as api
from mqslam.backend.loops.passes import MappedDrive
from mqslam.backend.loops.recognition import describe_places
from mqslam.config import Config, dump_yaml, set_doppler_beta
from mqslam.core import se2
from mqslam.core.keyframes import KeyframeMap, MappedRecording
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all
from mqslam.execution.local_engine import HERE
from mqslam.formats.covariances import read_covariances
from mqslam.formats.maps.keyframe_folder import write_keyframes
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import read_tum, write_tum
from mqslam.mapping.keyframing import make_keyframes
from mqslam.psi.place import beam_of

NAMES = "trajectory.tum covariances.csv poses.csv config.yaml summary.json run.log report.html ground_truth.tum"
FILES = set(NAMES.split())


@pytest.fixture(scope="module")
def mapped(street: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result that keeps the map of the street under its true poses."""
    result, config = tmp_path_factory.mktemp("mapped") / "result", set_doppler_beta(Config(), 0.0)
    result.mkdir()
    recording, beam = open_recording(street), beam_of(config.estimator, 0.0)
    scans, _ = detect_all(recording, config.detector)
    poses = read_tum(street / "gt" / "poses_tum.txt").at(scans.stamps_us)
    source = MappedRecording(str(street), recording.start_us, recording.end_us, recording.revolution_s, 0.0)
    keyframes = make_keyframes(scans, poses, None, source, beam)
    places = describe_places(MappedDrive.of(keyframes), beam, HERE)
    write_keyframes(result / "keyframes", KeyframeMap(keyframes, places))
    (result / "config.yaml").write_text(dump_yaml(config), encoding="utf-8")
    return result


@pytest.fixture(scope="module")
def localised(street: Path, mapped: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("localised") / "out"
    result = mqslam("localise", street, "--map", mapped, "--out", out, "--frontend", "odometry", "--jobs", 1)
    assert result.code == 0 and "scans converged" in result.out and f"report: {out}/report.html" in result.out
    return out


def test_the_poses_lie_in_the_maps_frame_with_covariance_and_status(street: Path, localised: Path) -> None:
    assert {path.name for path in localised.iterdir()} == FILES
    track, truth = read_tum(localised / "trajectory.tum"), read_tum(street / "gt" / "poses_tum.txt")
    off = se2.wrapped_between(truth.at(track.stamps_us), track.poses)
    rows = list(csv.DictReader((localised / "poses.csv").read_text().splitlines()))
    on_map = np.array([row["status"] == "converged" for row in rows])
    assert len(rows) == len(track) and on_map.mean() > 0.9
    assert np.hypot(off[on_map, 0], off[on_map, 1]).max() < 0.2 and np.abs(off[on_map, 2]).max() < np.radians(1.0)
    assert float(rows[7]["x_m"]) == pytest.approx(track.poses[7, 0], abs=1e-3)
    given = read_covariances(localised / "covariances.csv")
    assert given.stamps_us.tolist() == track.stamps_us.tolist()
    own = se2.rotate_covariance(given.covariances[7], -float(track.poses[7, 2]))
    assert float(rows[7]["sigma_along_m"]) == pytest.approx(np.sqrt(own[0, 0]), rel=1e-3)


def test_covariances_stay_along_the_maps_axes_in_other_files(localised: Path, tmp_path: Path) -> None:
    moved, known = shutil.copytree(localised, tmp_path / "moved"), read_covariances(localised / "covariances.csv")
    track = read_tum(moved / "trajectory.tum")
    write_tum(moved / "trajectory.tum", Trajectory(track.stamps_us, track.poses + np.array([0.0, 0.0, 1.0])))  # no yaw is 0
    assert mqslam("convert", moved, tmp_path / "poses.tum").code == 0
    converted = read_covariances(tmp_path / "poses.tum")
    assert not converted.of_first_pose and converted.stamps_us.tolist() == known.stamps_us.tolist()
    np.testing.assert_allclose(converted.covariances, known.covariances, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "width"), [("light", 1400), ("dark", 500)])
def test_axe_finds_no_serious_fault_in_the_page(localised: Path, scheme: str, width: int) -> None:
    assert find_faults(localised / "report.html", scheme, width) == []


def test_the_summary_says_what_was_found(street: Path, mapped: Path, localised: Path) -> None:
    summary = parse_strict_json((localised / "summary.json").read_text())
    assert summary["dataset"]["path"] == str(street) and summary["map"]["path"] == str(mapped)
    assert sum(summary["scans"].values()) == summary["dataset"]["scans"]
    assert summary["share_on_map"] == summary["scans"]["converged"] / summary["dataset"]["scans"]
    assert summary["frontend"] == "odometry" and summary["rows_recognised"] >= 1
    assert any("too short to measure how accurate" in warning for warning in summary["warnings"])
    assert str(street) in (localised / "run.log").read_text()


def test_the_recording_of_the_map_is_not_needed(street: Path, mapped: Path, localised: Path, tmp_path: Path) -> None:
    moved = tmp_path / "map"
    shutil.copytree(mapped / "keyframes", moved)
    index = json.loads((moved / "index.json").read_text())
    index["recordings"][0]["path"] = "/gone"
    (moved / "index.json").write_text(json.dumps(index))
    result = api.localise(street, tmp_path / "out", map=moved, frontend="odometry")  # the folder itself, without settings
    expected = read_tum(localised / "trajectory.tum")
    np.testing.assert_allclose(result.read_trajectory().poses, expected.poses, rtol=0.0, atol=1e-6)


def test_the_plot_shows_the_map_or_says_that_it_is_gone(mapped: Path, localised: Path, tmp_path: Path) -> None:
    shown = mqslam("plot", localised, "--out", tmp_path / "map.svg")
    assert (shown.code, shown.err) == (0, "") and "<image" in (tmp_path / "map.svg").read_text()
    moved = shutil.copytree(localised, tmp_path / "moved")
    summary = json.loads((moved / "summary.json").read_text())
    summary["map"]["path"] = str(tmp_path / "gone")
    (moved / "summary.json").write_text(json.dumps(summary))
    shown = mqslam("plot", moved, "--out", tmp_path / "path.svg")
    said = f"note: {tmp_path / 'gone'}: does not hold the map of this localisation (any more), so that the figure shows only"
    assert shown.code == 0 and shown.err.startswith(said) and shown.err.count("\n") == 1
    assert "<image" not in (tmp_path / "path.svg").read_text()


def test_a_stretch_of_a_recording_lies_where_the_whole_does(
    street: Path, mapped: Path, localised: Path, tmp_path: Path
) -> None:
    words = ("--frontend", "odometry", "--start", 5, "--end", 11, "--jobs", 1, "--quiet")
    assert mqslam("localise", street, "--map", mapped, "--out", tmp_path / "out", *words).code == 0
    whole, part = (read_tum(folder / "trajectory.tum") for folder in (localised, tmp_path / "out"))
    begin, end = 1e-6 * (part.stamps_us[[0, -1]] - whole.stamps_us[0])
    assert 5.0 <= begin < 6.0 and 10.0 < end < 11.0
    np.testing.assert_allclose(part.poses, whole.at(part.stamps_us), atol=0.2)


def test_the_errors_against_the_truth_are_those_that_evo_computes(localised: Path) -> None:
    summary = json.loads((localised / "summary.json").read_text())
    metrics, sync, files = (
        pytest.importorskip(f"evo.{name}") for name in ("core.metrics", "core.sync", "tools.file_interface")
    )
    names = "trajectory.tum", "ground_truth.tum"
    given, true = (files.read_tum_trajectory_file(localised / name) for name in names)
    true, given = sync.associate_trajectories(true, given, max_diff=1e-4)
    given.align(true)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((true, given))
    assert summary["evaluation"]["ate_rmse_m"] == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse), abs=1e-6)


def test_a_topic_that_is_of_nothing_is_refused(street: Path, mapped: Path, tmp_path: Path) -> None:
    result = mqslam("localise", street, "--map", mapped, "--out", tmp_path / "out", "--topic", "lidar=/front")
    assert result.code == 2 and "--topic lidar=/front: 'lidar' before '=' is no topic that mqslam reads" in result.err


def test_topics_of_the_maps_own_bag_are_not_asked_of_another_recording(street: Path, mapped: Path, tmp_path: Path) -> None:
    shutil.copytree(mapped, tmp_path / "result")
    settings = yaml.safe_load((mapped / "config.yaml").read_text())
    settings["sensor"]["radar_topic"] = "/front"
    (tmp_path / "result" / "config.yaml").write_text(yaml.safe_dump(settings))
    words = ("--frontend", "odometry", "--end", 9, "--jobs", 1, "--quiet")
    assert mqslam("localise", street, "--map", tmp_path / "result", "--out", tmp_path / "out", *words).code == 0


def test_another_town_is_refused_with_what_was_tried(mapped: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    assert mqslam("simulate", other, "--scene", "street", "--duration", 10, "--seed", 7, "--quiet").code == 0
    words = ("localise", other, "--map", mapped, "--out", tmp_path / "out", "--frontend", "odometry")
    result = mqslam(*words, "--jobs", 1, "--quiet")
    assert result.code == 2 and f"{other}: not in this map" in result.err and result.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def change_index(**changes: Any) -> Callable[[Path], object]:
    """Returns a function that changes the index of a map: its values, and what it says its places are described with."""

    def spoil(folder: Path) -> None:
        path = folder / "keyframes" / "index.json"
        index = json.loads(path.read_text())
        index["described_with"] |= changes.pop("described_with", {})
        path.write_text(json.dumps(index | changes))

    return spoil


def truncate(folder: Path) -> None:
    path = folder / "keyframes" / "points.npy"
    path.write_bytes(path.read_bytes()[:-100])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda folder: shutil.rmtree(folder / "keyframes"), "holds no map"),
        (change_index(version=99), "is of version 99"),
        (truncate, "points.npy"),
        (change_index(described_with={"rings": 7}), "do not fit index.json"),
        (change_index(described_with={"colour": "red"}), "settings that this version does not know"),
        (lambda folder: (folder / "config.yaml").write_text("nonsense: {}\n"), "nonsense"),
    ],
)
def test_a_map_that_cannot_be_used_is_named(
    street: Path, mapped: Path, tmp_path: Path, spoil: Callable[[Path], object], message: str
) -> None:
    result_folder = tmp_path / "result"
    shutil.copytree(mapped, result_folder)
    spoil(result_folder)
    result = mqslam("localise", street, "--map", result_folder, "--out", tmp_path / "out", "--frontend", "odometry")
    assert result.code == 2 and message in result.err and str(result_folder) in result.err
    assert "Traceback" not in result.err and result.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("frontend", mostly_slow(("psi", "kiss_icp"), ("psi",)))
def test_any_front_end_measures_the_motions(street: Path, mapped: Path, tmp_path: Path, frontend: str) -> None:
    out = tmp_path / "out"
    words = ("localise", street, "--map", mapped, "--out", out, "--frontend", frontend, "--odometry", "none", "--quiet")
    assert mqslam(*words, "--jobs", 1).code == 0
    track, truth = read_tum(out / "trajectory.tum"), read_tum(street / "gt" / "poses_tum.txt")
    off = se2.wrapped_between(truth.at(track.stamps_us), track.poses)
    assert np.median(np.hypot(off[:, 0], off[:, 1])) < 0.1


def test_what_is_at_out_is_not_overwritten(street: Path, mapped: Path, localised: Path) -> None:
    result = mqslam("localise", street, "--map", mapped, "--out", localised)
    assert result.code == 2 and "exists already" in result.err
