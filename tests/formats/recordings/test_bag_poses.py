"""The frame that its messages name decides whose poses a bag holds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.conversions import convert

from mqslam.core import se2
from mqslam.core.sensors.mount import Mount
from mqslam.core.trajectory import Trajectory
from mqslam.formats.lidars.mounts import Mounts
from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.bag_poses import Frames

RADAR = np.array([2.0, 0.5, 0.2])
IMU = np.array([-1.0, 0.25, -0.4])
VEHICLE = Trajectory(np.arange(3) * 250_000, np.array([[0.0, 0.0, 0.0], [1.0, 0.1, 0.3], [2.0, 0.5, -0.7]]))


def frames(*placed: str, mounted: bool = True) -> Frames:
    """Returns the frames of a bag that places some of them on the vehicle."""
    mounts = Mounts()
    for name in placed:
        x, y, yaw = {"radar": RADAR, "imu": IMU}[name]
        matrix = np.eye(4)
        matrix[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
        matrix[:2, 3] = x, y
        mounts.parents[name] = ("base_link", matrix)
    return Frames("radar", Mount(RADAR, "/tf_static") if mounted else None, mounts)


def seen_by(place: np.ndarray) -> Trajectory:
    """Returns the vehicle's drive as poses of something on it."""
    return Trajectory(VEHICLE.stamps_us, se2.compose(VEHICLE.poses, place))


@pytest.mark.parametrize(
    ("frame", "told"),
    [("base_link", VEHICLE), ("radar", seen_by(RADAR)), ("/imu", seen_by(IMU)), ("unheard_of", VEHICLE), ("", VEHICLE)],
)
def test_odometry_becomes_that_of_the_vehicle_where_the_mount_is_known(frame: str, told: Trajectory) -> None:
    carried, note = frames("radar", "imu").place_odometry(told, "/odom", frame)
    np.testing.assert_allclose(carried.poses, VEHICLE.poses, atol=1e-12)
    assert "/odom" in note


@pytest.mark.parametrize("frame", ["base_link", "radar", "imu", ""])
def test_odometry_stays_as_it_is_where_nothing_says_how_the_radar_is_mounted(frame: str) -> None:
    carried, note = frames("imu", mounted=False).place_odometry(VEHICLE, "/odom", frame)
    assert carried is VEHICLE and note.endswith("is taken as the motion of the radar itself")


@pytest.mark.parametrize(("frame", "told"), [("base_link", VEHICLE), ("radar", seen_by(RADAR)), ("imu", seen_by(IMU))])
def test_ground_truth_becomes_that_of_the_radar(frame: str, told: Trajectory) -> None:
    carried, note = frames("radar", "imu").place_truth(told, "/gt", frame)
    np.testing.assert_allclose(carried.poses, seen_by(RADAR).poses, atol=1e-12)
    assert f"is the pose of {'the radar' if frame == 'radar' else frame}" in note


def test_ground_truth_that_cannot_be_carried_says_whose_it_is() -> None:
    carried, note = frames("imu", mounted=False).place_truth(VEHICLE, "/gt", "imu")
    assert carried is VEHICLE and note.endswith("is the pose of imu; nothing says where the radar sits on it")
    assert frames("radar").place_truth(VEHICLE, "/gt", "")[1].endswith("is taken as the pose of the radar itself")


def test_odometry_and_ground_truth_keep_their_frames_through_a_bag(oxford: Path, tmp_path: Path) -> None:
    recording = open_recording(oxford, range_resolution=0.5)
    stamps = recording.stamps_us
    drive = Trajectory(stamps, np.column_stack((np.arange(len(stamps)) * 1.5, np.zeros(len(stamps)), np.zeros(len(stamps)))))
    recording = replace(recording, odometry=drive, ground_truth=drive, mount=Mount(RADAR, "given"))
    back = open_recording(convert(recording, tmp_path, "mcap")[0])
    assert back.odometry is not None and back.ground_truth is not None
    np.testing.assert_allclose(back.odometry.poses, drive.poses, atol=1e-9)
    np.testing.assert_allclose(back.ground_truth.poses, drive.poses, atol=1e-9)
    assert any("is the motion of base_link" in note for note in back.notes)
    assert any("is the pose of the radar" in note for note in back.notes)
