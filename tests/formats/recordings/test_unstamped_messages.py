"""Messages of bags whose headers have no stamps are taken at the times at which they were recorded, and that is said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg
from support.recordings import KINDS, START_US, TURN_US, Bag, bag_path, bag_writer, circle, oxford_rows

from mqslam.errors import DataError
from mqslam.formats.lidars.laserscan import read_lidar
from mqslam.formats.recordings import open_recording
from mqslam.formats.trajectories import read_with_notes

IMAGE, ODOMETRY, POSE = "sensor_msgs/msg/Image", "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
SCAN, PATH, TF = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Path", "tf2_msgs/msg/TFMessage"
TRACK = circle(START_US + np.arange(0, 1_600_000, 50_000))
SAID = "messages on {} have no stamps in their headers: they are taken at the times at which they were recorded"


def write_poses(bag: Bag, topic: str, kind: str = ODOMETRY, stamped: int = 0) -> None:
    """Writes poses, of which so many first ones have stamps."""
    connection = bag.topic(topic, kind)
    make = bag.odometry if kind == ODOMETRY else bag.pose_stamped
    for k, (stamp, pose) in enumerate(zip(TRACK.stamps_us.tolist(), TRACK.poses, strict=True)):
        bag.write(connection, stamp, make(stamp if k < stamped else 0, pose))


@pytest.mark.parametrize("kind", KINDS)
def test_odometry_and_ground_truth_without_stamps_are_used(tmp_path: Path, kind: str) -> None:
    path = bag_path(tmp_path, kind)
    with bag_writer(path, kind) as bag:
        write_poses(bag, "/odom")
        write_poses(bag, "/ground_truth/pose", POSE)
        radar = bag.topic("/Navtech/Polar", IMAGE)
        for k in range(6):
            bag.write(radar, START_US + k * TURN_US, bag.image(START_US + k * TURN_US, oxford_rows(k)))
    recording = open_recording(path)
    for track, topic in ((recording.odometry, "/odom"), (recording.ground_truth, "/ground_truth/pose")):
        assert track is not None
        np.testing.assert_array_equal(track.stamps_us, TRACK.stamps_us)
        assert "the " + SAID.format(topic) in recording.notes


def test_some_messages_without_stamps_are_counted(tmp_path: Path) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        write_poses(bag, "/odom", stamped=30)
    track, notes = read_with_notes(tmp_path / "drive.bag")
    np.testing.assert_array_equal(track.stamps_us, TRACK.stamps_us)
    assert notes == ["2 of 32 " + SAID.format("/odom")]


def test_radar_images_without_stamps_say_so(tmp_path: Path) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        radar = bag.topic("/Navtech/Polar", IMAGE)
        for k in range(6):
            bag.write(radar, START_US + k * TURN_US, bag.image(0, oxford_rows(k)[:, 11:]))
    recording = open_recording(tmp_path / "drive.bag")
    assert recording.start_us == START_US and len(list(recording.polar_scans())) == 6
    assert "the " + SAID.format("/Navtech/Polar") in recording.notes


def test_scans_of_a_lidar_and_its_odometry_without_stamps_say_so(tmp_path: Path) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        write_poses(bag, "/odom")
        scans = bag.topic("/scan", SCAN)
        for k in range(6):
            ranges = np.array([1, 2, 3, 4, 5], np.float32)
            limits = (-1.0, 1.0, 0.5, 1e-3, 0.1, 0.1, 30.0)
            message = bag.store.types[SCAN](bag.header(0), *limits, ranges, np.zeros(0, np.float32))
            bag.write(scans, START_US + k * TURN_US, message)
    recording = read_lidar(tmp_path / "drive.bag")
    assert recording.odometry is not None and recording.scans.stamps_us[0] == START_US
    assert {"the " + SAID.format(topic) for topic in ("/odom", "/scan")} <= set(recording.notes)


def test_transforms_without_stamps_say_so(tmp_path: Path) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        bag.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", TF))
        types = bag.store.types

        def link(parent: str, child: str, pose: Any) -> Any:
            header = bag.header(0)
            header.frame_id = parent
            turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(pose[2] / 2), np.cos(pose[2] / 2))
            move = types["geometry_msgs/msg/Transform"](types["geometry_msgs/msg/Vector3"](pose[0], pose[1], 0.0), turn)
            return types[TF]([types["geometry_msgs/msg/TransformStamped"](header, child, move)])

        moving, static = bag.topic("/tf", TF), bag.topic("/tf_static", TF)
        bag.write(static, START_US, link("base_link", "radar", np.zeros(3)))
        for stamp, pose in zip(TRACK.stamps_us.tolist(), TRACK.poses, strict=True):
            bag.write(moving, stamp, link("map", "base_link", pose))
    track, notes = read_with_notes(tmp_path / "drive.bag")
    np.testing.assert_array_equal(track.stamps_us, TRACK.stamps_us)
    assert notes == ["the " + SAID.format("/tf")]  # static transforms need none


def test_a_path_without_stamps_is_refused_for_that(tmp_path: Path) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        poses = [bag.pose_stamped(0, pose) for pose in TRACK.poses]
        bag.write(bag.topic("/path", PATH), START_US, bag.store.types[PATH](bag.header(START_US), poses))
    with pytest.raises(DataError, match="holds a path without stamps on /path; name a topic whose poses have stamps"):
        read_with_notes(tmp_path / "drive.bag")


def test_odometry_that_stands_at_one_time_is_not_lost_without_a_word(tmp_path: Path) -> None:
    with bag_writer(tmp_path / "drive.bag", "ros1") as bag:
        connection, radar = bag.topic("/odom", ODOMETRY), bag.topic("/Navtech/Polar", IMAGE)
        for k in range(6):
            stamp = START_US + k * TURN_US
            bag.write(connection, stamp, bag.odometry(START_US, TRACK.poses[k]))
            bag.write(radar, stamp, bag.image(stamp, oxford_rows(k)))
    recording = open_recording(tmp_path / "drive.bag")
    assert recording.odometry is None
    assert "/odom is left out: it holds no two poses at different times" in recording.faults
