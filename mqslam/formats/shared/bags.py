"""What every reader of ROS bags shares: opening them, naming the message at fault, stamps and planar poses."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError, MqslamError
from mqslam.formats.shared.poses import yaw_of_quaternion

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
POSE_TYPE = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE_TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"
PATH_TYPE = "nav_msgs/msg/Path"
TRUTH_NAME = re.compile(r"truth|(?<![a-z])gt(?![a-z])")
PoseRow = tuple[int, float, float, float]


def recognises(path: Path) -> bool:
    """Whether the path is a `.bag`, `.mcap` or `.db3` file, or a folder with a `metadata.yaml`."""
    return path.suffix in (".bag", ".mcap", ".db3") if path.is_file() else (path / "metadata.yaml").is_file()


@contextlib.contextmanager
def opened(path: Path, definitions: Mapping[str, str] | None = None) -> Iterator[AnyReader]:
    """The bag, open.

    Args:
        path: a ROS 1 `.bag`, a ROS 2 folder, `.db3` or `.mcap`.
        definitions: message definitions by type, for types that ROS itself does not know.

    Raises:
        DataError: not a readable bag.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for message_type, definition in (definitions or {}).items():
        store.register(get_types_from_msg(definition, message_type))
    try:
        with AnyReader([path], default_typestore=store) as reader:
            yield reader
    except MqslamError:
        raise
    except Exception as error:  # on damaged files rosbags lets through whatever struct, zlib, apsw, yaml... raise
        reason = (str(error) or type(error).__name__).splitlines()[0]
        remedy = "copy it anew, or repair it with 'rosbag reindex' or 'mcap recover'"
        raise DataError(path, f"is not a readable bag ({reason})", remedy) from error


@contextlib.contextmanager
def naming(path: Path, topic: str, logged_ns: int) -> Iterator[None]:
    """Errors of a message become errors of the bag that name it."""
    try:
        yield
    except ValueError as error:
        remedy = "cut it out of the bag, or name another bag"
        raise DataError(path, f"the message on {topic} recorded at {logged_ns} ns {error}", remedy) from error


def deserialised(reader: AnyReader, connection: Connection, raw: bytes) -> Any:
    """A message.

    Raises:
        ValueError: its bytes are not those of its type.
    """
    try:
        return reader.deserialize(raw, connection.msgtype)
    except Exception as error:  # the code that rosbags makes of a type lets through whatever struct and NumPy raise
        raise ValueError(f"is damaged ({str(error) or type(error).__name__})") from error


def topics_there(reader: AnyReader) -> str:
    """The bag's topics with their types, twelve at most, for an error to list."""
    return ", ".join(f"{c.topic} [{c.msgtype}]" for c in reader.connections[:12]) or "none"


def header_us(message: Any) -> int:
    """Stamp [us] of a message's header."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000 + int(stamp.nanosec) // 1000


def pose_row(message_type: str, message: Any) -> PoseRow:
    """Stamp [us] and planar pose (x, y [m], yaw [rad]) of an odometry or pose message."""
    pose = message.pose if message_type == POSE_TYPE else message.pose.pose
    q = pose.orientation
    return header_us(message), pose.position.x, pose.position.y, yaw_of_quaternion(q.x, q.y, q.z, q.w)


def trajectory_of(rows: Iterable[PoseRow]) -> Trajectory | None:
    """The finite poses in the order of their stamps, or None where there are not two."""
    kept = sorted({row[0]: row for row in rows if np.isfinite(row[1:]).all()}.values())
    if len(kept) < 2:
        return None
    return Trajectory(np.array([row[0] for row in kept], dtype=np.int64), np.array([row[1:] for row in kept]))
