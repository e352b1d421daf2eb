"""Trajectories in ROS bags: a topic of poses, or the transforms between frames."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.shared import bags
from mqslam.formats.trajectories.transforms import Transforms

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

_POSE_TYPES = (bags.ODOMETRY_TYPE, bags.POSE_TYPE, bags.POSE_WITH_COVARIANCE_TYPE, bags.PATH_TYPE)
_TRANSFORM_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_STATIC = "tf_static"
_AT_ONCE_US = 10_000  # nothing drives in so short a time: whoever wrote the bag did so afterwards


def read_bag(path: Path, topic: str | None, frame: str | None) -> tuple[Trajectory, list[str]]:
    """Reads the trajectory in a bag, and what a user should know about how it was understood.

    Args:
        path: the bag.
        topic: a topic of poses or of transforms; None takes the only one of poses, or all transforms where there is none.
        frame: a frame whose pose the transforms give; None takes a vehicle's usual one, or the only one that moves.

    Raises:
        DataError: there is no such trajectory, or several.
    """
    with bags.open_bag(path) as reader:
        filled = [c for c in reader.connections if c.msgcount]
        poses = sorted({c.topic for c in filled if c.msgtype in _POSE_TYPES})
        transforms = [c for c in filled if c.msgtype in _TRANSFORM_TYPES]
        moving = sorted({c.topic for c in transforms if not _is_static(c)})
        if topic in moving or (topic is None and moving and (frame is not None or not poses)):
            read = [c for c in transforms if topic in (None, c.topic) or _is_static(c)]
            return _read_transforms(path, reader, read, frame)
        if frame is not None:
            problem = f"has no transforms on {topic}" if topic else "has no transforms"
            raise DataError(path, f"{problem} (topics: {bags.list_topics(reader)})", "leave the frame out")
        chosen = [name for name in poses if topic in (None, name)]
        if len(chosen) != 1:
            problem = f"has no poses on {topic}" if topic else f"has {len(chosen)} topics of poses"
            there = [*poses, *moving]
            listed = f"topics of poses: {', '.join(there[:12])}" if there else f"topics: {bags.list_topics(reader)}"
            raise DataError(path, f"{problem} ({listed})", "name the topic of the trajectory")
        return _read_poses(path, reader, chosen[0])


def _is_static(connection: Connection) -> bool:
    """Returns whether a topic of transforms holds those that never change."""
    return connection.topic.rsplit("/", 1)[-1] == _STATIC


def _read_poses(path: Path, reader: AnyReader, topic: str) -> tuple[Trajectory, list[str]]:
    """Reads the poses on a topic, and says how many of them are left out."""
    poses: list[bags.PoseRow] = []
    clock = bags.Clock()
    for connection, logged, raw in reader.messages([c for c in reader.connections if c.topic == topic]):
        message: Any = reader.deserialize(raw, connection.msgtype)
        if connection.msgtype == bags.PATH_TYPE:
            poses = [bags.pose_of(bags.POSE_TYPE, pose, bags.stamp_of(pose)) for pose in message.poses]
        else:
            poses.append(bags.pose_of(connection.msgtype, message, clock.stamp(topic, message, logged)))
    trajectory = bags.trajectory_of(poses)
    if trajectory is None and len(poses) > 1 and not any(pose[0] for pose in poses):
        raise DataError(path, f"holds a path without stamps on {topic}", "name a topic whose poses have stamps")
    at_once = (
        trajectory is not None and bool(clock.unstamped) and trajectory.stamps_us[-1] - trajectory.stamps_us[0] < _AT_ONCE_US
    )
    if trajectory is None or at_once:
        why = ": their headers have no stamps, and all were recorded at once" if at_once else ""
        raise DataError(path, f"holds no two poses at different times on {topic}{why}", "name another topic")
    return trajectory, clock.notes + bags.note_left_out(poses, topic)


def _read_transforms(
    path: Path, reader: AnyReader, connections: list[Connection], frame: str | None
) -> tuple[Trajectory, list[str]]:
    """Reads the pose of a frame from the transforms on some topics, and says how many of them are left out."""
    transforms = Transforms()
    for connection, logged, raw in reader.messages(connections):
        message: Any = reader.deserialize(raw, connection.msgtype)
        transforms.add(message, connection.topic, logged)
    try:
        return transforms.trace(transforms.choose(frame)), transforms.notes
    except ValueError as error:
        raise DataError(path, str(error), "name another frame, or a topic of poses") from error
