"""Parts that all writers of ROS bags share: a bag that is written whole or not at all, headers and planar poses."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mqslam.core import se2
from mqslam.errors import OutputError
from mqslam.execution.files import write_aside
from mqslam.execution.folders import write_folder_aside
from mqslam.formats.shared.bags import B_SCAN_DEFINITION, B_SCAN_TYPE

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.typesys.store import Typestore

KINDS = {"rosbag1": ".bag", "mcap": ".mcap", "rosbag2": "", "rosbag2_mcap": ""}
"""Bags that can be written, with their suffixes: a ROS 1 file, a bare mcap, and ROS 2 folders with sqlite3 or mcap."""
RADAR_FRAME, VEHICLE_FRAME = "radar", "base_link"
"""Frames of the radar and of the vehicle in every bag that is written."""
TF_TYPE = "tf2_msgs/msg/TFMessage"
_DEFINITIONS = {B_SCAN_TYPE: B_SCAN_DEFINITION, TF_TYPE: "geometry_msgs/TransformStamped[] transforms\n"}
_LATEST_US = 2**31 * 1_000_000  # ROS 2 counts seconds in 31 bits [us]


@dataclass(frozen=True, slots=True)
class Bag:
    """A bag being written.

    Args:
        writer: of rosbags, for ROS 1 or 2.
        store: the message types it knows.
        is_ros1: which of the two it is.
    """

    writer: Any
    store: Typestore
    is_ros1: bool

    def topic(self, name: str, message_type: str, *, latched: bool = False) -> Connection:
        """Adds a topic; a latched one is played such that late subscribers still get its last message."""
        kept: dict[str, Any] = {"latching": 1} if self.is_ros1 else {"offered_qos_profiles": [_make_latched_qos()]}
        connection: Connection = self.writer.add_connection(
            name, message_type, typestore=self.store, **(kept if latched else {})
        )
        return connection

    def write(self, connection: Connection, stamp_us: int, message: Any) -> None:
        """Writes a message as recorded at a stamp [us]."""
        serialise = self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr
        self.writer.write(connection, stamp_us * 1000, serialise(message, connection.msgtype))

    def make(self, message_type: str, *fields: Any) -> Any:
        """Makes a message of a type from its fields in their order."""
        return self.store.types[message_type](*fields)

    def header(self, stamp_us: int, frame: str) -> Any:
        """Makes the header of a message in a frame.

        Raises:
            OutputError: the stamp lies before 1970 or after 2038, which ROS cannot hold.
        """
        if not 0 <= stamp_us < _LATEST_US:
            raise OutputError(f"{self.writer.path}: stamp {stamp_us} us is outside ROS's clock; write .npz or a folder")
        stamp = self.make("builtin_interfaces/msg/Time", stamp_us // 1_000_000, stamp_us % 1_000_000 * 1000)
        return self.make("std_msgs/msg/Header", *((0, stamp, frame) if self.is_ros1 else (stamp, frame)))

    def vector(self, x: float, y: float, z: float) -> Any:
        """Makes a `geometry_msgs/Vector3`."""
        return self.make("geometry_msgs/msg/Vector3", x, y, z)

    def quaternion(self, yaw: float) -> Any:
        """Makes a `geometry_msgs/Quaternion` of a yaw [rad]."""
        return self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))

    def pose(self, pose: se2.Array) -> Any:
        """Makes a `geometry_msgs/Pose` of x, y [m], yaw [rad]."""
        x, y, yaw = pose.tolist()
        return self.make("geometry_msgs/msg/Pose", self.make("geometry_msgs/msg/Point", x, y, 0.0), self.quaternion(yaw))


@contextlib.contextmanager
def write_bag(out: Path, kind: str) -> Iterator[Bag]:
    """Writes a bag of one of `KINDS` that takes the place of `out` when the block ends without an error.

    Raises:
        OutputError: the bag cannot be written.
    """
    try:
        with (_write_file if kind in ("rosbag1", "mcap") else _write_folder)(out, kind) as bag:
            yield bag
    except sqlite3.Error as error:
        raise OutputError(f"{out}: cannot be written ({error}); free space or choose another output") from error


@contextlib.contextmanager
def _write_file(out: Path, kind: str) -> Iterator[Bag]:
    with write_aside(out) as aside, tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as folder:
        path = Path(folder) / out.name
        with _start_bag(path, kind) as bag:
            yield bag
        (path if path.is_file() else next(path.glob("*.mcap"))).replace(aside)


@contextlib.contextmanager
def _write_folder(out: Path, kind: str) -> Iterator[Bag]:
    if kind == "rosbag2" and set("?#%") & set(str(out)):
        raise OutputError(f"{out}: sqlite takes ?, # and % in a path for something else; choose another output")
    with write_folder_aside(out) as aside:
        inside = aside / out.name  # ROS 2 names the files in a bag after its folder
        with _start_bag(inside, kind) as bag:
            yield bag
        for file in list(inside.iterdir()):
            shutil.move(file, aside)
        inside.rmdir()


@contextlib.contextmanager
def _start_bag(path: Path, kind: str) -> Iterator[Bag]:
    """Starts a bag at a path where nothing is yet."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    is_ros1 = kind == "rosbag1"
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    for message_type, definition in _DEFINITIONS.items():
        if message_type not in store.types:
            store.register(get_types_from_msg(definition, message_type))
    # some distributions that are still in use do not know version 9 of the metadata
    plugin = StoragePlugin.SQLITE3 if kind == "rosbag2" else StoragePlugin.MCAP
    with Writer1(path) if is_ros1 else Writer2(path, version=8, storage_plugin=plugin) as writer:
        yield Bag(writer, store, is_ros1)


def _make_latched_qos() -> Any:
    """Makes the quality of service of a topic that keeps its last message for late subscribers."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    forever = QosTime(9_223_372_036, 854_775_807)
    return Qos(
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        forever,
        forever,
        QosLiveliness.AUTOMATIC,
        forever,
        False,
    )
