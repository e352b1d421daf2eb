"""Poses of a bag are those of the radar, of the vehicle or of something on it, as their frames and /tf_static say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.recordings import START_US, TURN_US, circle

from mqslam.commands.audit import detect_radar
from mqslam.commands.inputs import choose_odometry, open_data
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.recording import Recording
from mqslam.core.sensors import Mount
from mqslam.execution.runner import Runner
from mqslam.formats.conversion import find_target, write_recording
from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.rosbag import Frames
from mqslam.formats.transforms import Mounts

TRACK = circle(START_US + TURN_US * np.arange(9))
RADAR = np.array([1.0, 0.2, np.pi / 2])
TABLE = np.array([0.4, 0.0, 0.1])
ON_VEHICLE = Mount(RADAR, "/tf_static")


def placed(**poses: np.ndarray) -> Mounts:
    """Returns static transforms that place frames on base_link."""
    parents = {}
    for frame, (x, y, yaw) in poses.items():
        numbers = (x, y, 0.0, 0.0, 0.0, np.sin(yaw / 2.0), np.cos(yaw / 2.0))
        parents[frame] = ("base_link", numbers, "/tf_static")
    return Mounts(parents)


KNOWN = Frames("radar", ON_VEHICLE, placed(radar=RADAR, table=TABLE))
UNKNOWN = Frames("radar", None, placed(table=TABLE))


@pytest.mark.parametrize("frame", ["base_link", "/base_link", "base_footprint"])
def test_ground_truth_of_the_vehicle_is_carried_to_the_radar(frame: str) -> None:
    truth, note, _ = KNOWN.place_truth(TRACK, "/gt", frame)
    np.testing.assert_allclose(truth.poses, se2.compose(TRACK.poses, RADAR), atol=1e-12)
    assert note == f"ground truth from /gt is the pose of {frame}, converted to poses of the radar by /tf_static"


def test_ground_truth_of_something_on_the_vehicle_is_carried_to_the_radar() -> None:
    table = replace(TRACK, poses=se2.compose(TRACK.poses, TABLE))
    truth, _, _ = KNOWN.place_truth(table, "/gt", "table")
    np.testing.assert_allclose(truth.poses, se2.compose(TRACK.poses, RADAR), atol=1e-12)


@pytest.mark.parametrize(("frames", "frame"), [(KNOWN, "radar"), (KNOWN, ""), (KNOWN, "other"), (UNKNOWN, "base_link")])
def test_ground_truth_stays_where_nothing_says_how_to_carry_it(frames: Frames, frame: str) -> None:
    truth, note, _ = frames.place_truth(TRACK, "/gt", frame)
    assert truth is TRACK and note.startswith("ground truth from /gt is ")


def test_only_poses_of_the_vehicle_itself_wait_for_extrinsics() -> None:
    def is_of_vehicle(frames: Frames, frame: str) -> bool:
        return frames.place_truth(TRACK, "/gt", frame)[2]

    assert is_of_vehicle(UNKNOWN, "base_link")
    assert not any(is_of_vehicle(UNKNOWN, frame) for frame in ("radar", "table", "other", ""))
    assert not is_of_vehicle(Frames("base_link", None, Mounts()), "base_link")  # the radar's frame is called so
    assert not is_of_vehicle(KNOWN, "base_link")


@pytest.mark.parametrize(("frame", "pose"), [("base_link", np.zeros(3)), ("radar", RADAR), ("table", TABLE)])
def test_odometry_becomes_that_of_the_vehicle_where_the_mount_is_known(frame: str, pose: np.ndarray) -> None:
    moved, note = KNOWN.place_odometry(replace(TRACK, poses=se2.compose(TRACK.poses, pose)), "/odom", frame)
    np.testing.assert_allclose(moved.poses, TRACK.poses, atol=1e-12)
    assert note == f"odometry from /odom is the motion of {frame}"


def test_odometry_of_a_frame_that_nothing_places_is_that_of_the_vehicle() -> None:
    moved, note = KNOWN.place_odometry(TRACK, "/odom", "wheels")
    assert moved is TRACK and note == "odometry from /odom is taken as the motion of the vehicle, on which radar sits"
    moved, note = UNKNOWN.place_odometry(TRACK, "/odom", "base_link")
    assert moved is TRACK and note == "odometry from /odom is taken as the motion of the radar itself"


def test_transforms_that_are_not_finite_place_nothing() -> None:
    broken = Frames("radar", ON_VEHICLE, placed(table=np.array([np.nan, 0.0, 0.0])))
    assert broken.place_truth(TRACK, "/gt", "table")[0] is TRACK


@pytest.fixture
def mounted(oxford: Path) -> Recording:
    """A recording of a mounted radar with odometry of its vehicle and ground truth of its own."""
    truth = replace(TRACK, poses=se2.compose(TRACK.poses, RADAR))
    return replace(open_recording(oxford), odometry=TRACK, ground_truth=truth, mount=ON_VEHICLE)


def convert(recording: Recording, out: Path) -> Recording:
    write_recording(recording, out, find_target(out), lambda done, of: None)
    return open_recording(out)


@pytest.mark.parametrize("name", ["drive.mcap", "drive.bag", "drive.npz"])
def test_a_converted_recording_says_the_same_of_vehicle_and_radar(mounted: Recording, tmp_path: Path, name: str) -> None:
    read = convert(mounted, tmp_path / name)
    assert read.mount is not None and read.odometry is not None and read.ground_truth is not None
    np.testing.assert_allclose(read.mount.pose, RADAR, atol=1e-9)
    np.testing.assert_allclose(read.odometry.poses, TRACK.poses, atol=1e-9)
    np.testing.assert_allclose(read.ground_truth.poses, se2.compose(TRACK.poses, RADAR), atol=1e-9)


def test_a_bag_keeps_that_its_ground_truth_is_the_vehicles(mounted: Recording, tmp_path: Path) -> None:
    of_vehicle = replace(mounted, ground_truth=TRACK, truth_on_vehicle=True, mount=None)
    read = convert(of_vehicle, tmp_path / "drive.mcap")
    assert read.truth_on_vehicle and read.ground_truth is not None
    np.testing.assert_allclose(read.ground_truth.poses, TRACK.poses, atol=1e-9)
    out = tmp_path / "drive.npz"
    notes = write_recording(of_vehicle, out, find_target(out), lambda done, of: None)
    assert "ground truth holds poses of the vehicle; readers of native will take them for the radar's" in notes


def test_a_run_and_an_audit_take_odometry_as_the_motion_of_the_radar(mounted: Recording, tmp_path: Path) -> None:
    expected = se2.compose(TRACK.poses, RADAR)
    track, notes = choose_odometry(mounted, "auto", mounted.mount)
    assert track is not None and notes == []
    np.testing.assert_allclose(track.poses, expected)
    unknown, _ = choose_odometry(mounted, "auto", None)
    assert unknown is mounted.odometry
    convert(mounted, tmp_path / "drive.mcap")
    config = Config.model_validate({"sensor": {"doppler_beta": 0.0}})
    _, audited, *_ = detect_radar(open_data(tmp_path / "drive.mcap", None, None, config), None, "odometry", config, Runner())
    np.testing.assert_allclose(audited.poses, expected, atol=1e-9)
