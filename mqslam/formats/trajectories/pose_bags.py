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
    for connection, _, raw in reader.messages([c for c in reader.connections if c.topic == topic]):
        message: Any = reader.deserialize(raw, connection.msgtype)
        if connection.msgtype == bags.PATH_TYPE:
            poses = [bags.pose_of(bags.POSE_TYPE, pose) for pose in message.poses]
        else:
            poses.append(bags.pose_of(connection.msgtype, message))
    trajectory = bags.trajectory_of(poses)
    if trajectory is None:
        raise DataError(path, f"holds no two poses at different times on {topic}", "name another topic")
    return trajectory, bags.note_left_out(poses, topic)


def _read_transforms(
    path: Path, reader: AnyReader, connections: list[Connection], frame: str | None
) -> tuple[Trajectory, list[str]]:
    """Reads the pose of a frame from the transforms on some topics, and says how many of them are left out."""
    transforms = Transforms()
    for connection, _, raw in reader.messages(connections):
        message: Any = reader.deserialize(raw, connection.msgtype)
        transforms.add(message)
    try:
        return transforms.trace(transforms.choose(frame)), transforms.notes
    except ValueError as error:
        raise DataError(path, str(error), "name another frame, or a topic of poses") from error
