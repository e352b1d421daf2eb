"""Trajectories from the transforms of a bag: which frame is meant, and where it was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.recordings import KINDS, START_US, TF, Bag, bag_path, bag_writer

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.trajectories import read_trajectory, read_with_notes

STEPS = 21
STAMPS = START_US + 50_000 * np.arange(STEPS)
CORRECTIONS = START_US - 20_000 + 200_000 * np.arange(6)
WHEELS = se2.exp(np.tile([4.0, 0.0, 0.8], (STEPS, 1)), 0.05 * np.arange(STEPS))  # odom -> base_link
DRIFT = np.c_[0.1 * np.arange(6), np.zeros(6), np.zeros(6)]  # map -> odom


class Tree:
    """A bag of transforms being filled."""

    def __init__(self, bag: Bag) -> None:
        self.bag = bag
        self.topics: dict[str, Any] = {}

    def add(
        self, stamp_us: int, names: tuple[str, str], pose: Any, topic: str = "/tf", lean: Rotation | None = None
    ) -> None:
        """Adds the transform of a frame in its parent: x, y [m], yaw [rad], and a rotation before that."""
        if topic not in self.topics:
            self.topics[topic] = self.bag.topic(topic, TF)
        x, y, yaw = pose
        turn = Rotation.from_euler("z", yaw) * (lean or Rotation.identity())
        message = self.bag.transform(stamp_us, names, (x, y, 0.3), turn.as_quat())
        self.bag.write(self.topics[topic], stamp_us, message)

    def drive(self, slash: str = "", body: str = "base_link") -> None:
        """Adds what a SLAM on a robot publishes: corrections, wheels, and a radar that is mounted to the left."""
        for stamp, pose in zip(CORRECTIONS.tolist(), DRIFT, strict=True):
            self.add(stamp, (f"{slash}map", f"{slash}odom"), pose)
        for stamp, pose in zip(STAMPS.tolist(), WHEELS, strict=True):
            self.add(stamp, (f"{slash}odom", f"{slash}{body}"), pose)
        self.add(START_US, (f"{slash}{body}", f"{slash}radar"), [0.4, 0.2, np.pi / 2], topic="/tf_static")


def expected() -> np.ndarray:
    """Returns base_link in the map: the correction moves straight, so that x is interpolated between its stamps."""
    return WHEELS + np.c_[np.interp(STAMPS, CORRECTIONS, DRIFT[:, 0]), np.zeros((STEPS, 2))]


def assert_at(result: Trajectory, poses: np.ndarray) -> None:
    kept = CORRECTIONS[-1] >= STAMPS
    np.testing.assert_array_equal(result.stamps_us, STAMPS[kept])
    np.testing.assert_allclose(result.poses[:, :2], poses[kept, :2], atol=1e-6)
    np.testing.assert_allclose(se2.wrap(result.poses[:, 2] - poses[kept, 2]), 0.0, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_a_chain_of_transforms_is_followed_from_the_map_to_the_body(tmp_path: Path, kind: str) -> None:
    path = bag_path(tmp_path, kind)
    with bag_writer(path, kind) as bag:
        Tree(bag).drive(slash="/" if kind == "ros1" else "")
    assert CORRECTIONS[-1] < STAMPS[-1]  # nothing is invented beyond the last correction
    assert_at(read_trajectory(path), expected())
    assert_at(read_trajectory(path, topic="/tf", frame="/base_link"), expected())
    sensor = [pose @ [[0, -1, 0.4], [1, 0, 0.2], [0, 0, 1]] for pose in map(matrix, expected())]
    poses = np.array([[m[0, 2], m[1, 2], np.arctan2(m[1, 0], m[0, 0])] for m in sensor])
    assert_at(read_trajectory(path, frame="radar"), poses)


def matrix(pose: np.ndarray) -> np.ndarray:
    x, y, yaw = pose
    return np.array([[np.cos(yaw), -np.sin(yaw), x], [np.sin(yaw), np.cos(yaw), y], [0.0, 0.0, 1.0]])


def test_the_only_frame_that_moves_is_the_vehicles(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    with bag_writer(path, "ros1") as bag:
        Tree(bag).drive(body="robot")
    assert_at(read_trajectory(path), expected())


def test_wheels_that_turn_on_the_body_are_not_the_vehicle_but_can_be_named(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    with bag_writer(path, "ros1") as bag:
        tree = Tree(bag)
        tree.drive()
        for k, stamp in enumerate(STAMPS.tolist()):
            tree.add(stamp, ("base_link", "wheel"), [0.0, 0.5, 0.0], lean=Rotation.from_euler("y", 0.05 * k))
    assert_at(read_trajectory(path), expected())
    assert_at(read_trajectory(path, frame="wheel"), se2.compose(expected(), [0.0, 0.5, 0.0]))


def test_one_of_several_vehicles_has_to_be_named(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    with bag_writer(path, "ros1") as bag:
        tree = Tree(bag)
        for name, shift in (("a", 0.0), ("b", 7.0)):
            for stamp, pose in zip(STAMPS.tolist(), WHEELS, strict=True):
                tree.add(stamp, ("map", f"{name}/base_link"), pose + np.array([shift, 0.0, 0.0]))
    with pytest.raises(
        DataError, match=r"2 frames that may be the vehicle's \(frames that move: a/base_link, b/base_link\)"
    ):
        read_trajectory(path)
    np.testing.assert_allclose(read_trajectory(path, frame="b/base_link").poses[0], [7.0, 0.0, 0.0], atol=1e-9)


def test_a_topic_of_poses_goes_before_transforms_unless_these_are_named(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    with bag_writer(path, "ros1") as bag:
        Tree(bag).drive()
        odometry = bag.topic("/odom", "nav_msgs/msg/Odometry")
        for stamp, pose in zip(STAMPS.tolist(), WHEELS, strict=True):
            bag.write(odometry, stamp, bag.odometry(stamp, pose))
    np.testing.assert_allclose(read_trajectory(path).poses, WHEELS, atol=1e-6)
    for named in ({"topic": "/tf"}, {"frame": "base_link"}):
        assert_at(read_trajectory(path, **named), expected())
    with pytest.raises(DataError, match=r"has no poses on /slam \(topics of poses: /odom, /tf\)"):
        read_trajectory(path, topic="/slam")
    with pytest.raises(DataError, match=r"has no transforms on /odom"):
        read_trajectory(path, topic="/odom", frame="base_link")


def test_a_static_transform_that_is_published_again_and_again_ends_nothing(tmp_path: Path) -> None:
    """ROS 1's static_transform_publisher sends what never changes on /tf, at stamps of its own."""
    path = tmp_path / "drive.bag"
    with bag_writer(path, "ros1") as bag:
        tree = Tree(bag)
        for stamp, pose in zip(STAMPS.tolist(), WHEELS, strict=True):
            tree.add(stamp, ("odom", "base_link"), pose)
        for stamp in STAMPS[3:5].tolist():
            tree.add(stamp, ("map", "odom"), [5.0, 0.0, 0.0])
    np.testing.assert_allclose(read_trajectory(path).poses, WHEELS + np.array([5.0, 0.0, 0.0]), atol=1e-6)


@pytest.mark.parametrize(
    ("links", "frame", "problem"),
    [
        ([("map", "odom", 0), ("odom", "base_link", 1), ("map", "base_link", 1)], None, r"several parents of the frame"),
        ([("map", "base_link", 1)], "radar", r"has no transforms by which the frame radar moves \(frames that move: base"),
        ([("map", "base_link", 0)], None, r"has no transforms by which the vehicle moves \(frames that move: none\)"),
        ([("a", "b", 1), ("b", "a", 1)], "a", r"places the frames a, b in a ring"),
    ],
)
def test_transforms_that_show_no_path_are_named(tmp_path: Path, links: Any, frame: str | None, problem: str) -> None:
    path = tmp_path / "drive.bag"
    with bag_writer(path, "ros1") as bag:
        tree = Tree(bag)
        for k, stamp in enumerate(STAMPS.tolist()):
            for parent, child, speed in links:
                tree.add(stamp, (parent, child), [float(speed * k), 0.0, 0.0])
    with pytest.raises(DataError, match=problem):
        read_trajectory(path, frame=frame)


def test_transforms_that_share_no_time_are_named(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    with bag_writer(path, "ros1") as bag:
        tree = Tree(bag)
        for k, stamp in enumerate(STAMPS.tolist()):
            tree.add(stamp, ("odom", "base_link"), [float(k), 0.0, 0.0])
            tree.add(stamp + 10**9, ("map", "odom"), [float(k), 0.0, 0.0])
    with pytest.raises(DataError, match=r"holds fewer than two times at which all of base_link, odom have a transform"):
        read_trajectory(path)


@pytest.mark.parametrize("x", [2e9, np.inf, np.nan])
def test_transforms_to_no_place_on_the_earth_are_left_out_and_counted(tmp_path: Path, x: float) -> None:
    path = tmp_path / "drive.bag"
    with bag_writer(path, "ros1") as bag:
        tree = Tree(bag)
        for k, (stamp, pose) in enumerate(zip(STAMPS.tolist(), WHEELS, strict=True)):
            tree.add(stamp, ("odom", "base_link"), pose if k != 4 else [x, 0.0, 0.0])
    track, notes = read_with_notes(path)
    np.testing.assert_allclose(track.poses, np.delete(WHEELS, 4, axis=0), atol=1e-6)
    why = "a quaternion of zeros, numbers that are not finite, or a place over 1e9 m away"
    assert f"1 transform is left out: {why}" in notes


def test_a_bag_without_transforms_has_no_frames(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    with bag_writer(path, "ros1") as bag:
        topic = bag.topic("/slam", "geometry_msgs/msg/PoseStamped")
        for stamp, pose in zip(STAMPS.tolist(), WHEELS, strict=True):
            bag.write(topic, stamp, bag.pose_stamped(stamp, pose))
    with pytest.raises(DataError, match=r"drive\.bag: has no transforms \(topics: /slam"):
        read_trajectory(path, frame="base_link")
