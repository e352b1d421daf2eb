"""Opens and writes ROS bags, reads their stamps and planar poses, and names the message that causes an error."""

from __future__ import annotations

import contextlib
import re
import shutil
import sqlite3
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of, is_or_are
from mqslam.errors import DataError, MqslamError, OutputError, untrusted
from mqslam.execution.files import write_aside
from mqslam.execution.folders import write_folder_aside
from mqslam.execution.guards.bag_bounds import bound_rosbags
from mqslam.formats.images import CONVERT_IMAGES, NotGreyError
from mqslam.formats.poses import mark_places, yaw_of_quaternion

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection
    from rosbags.typesys.store import Typestore

IMAGE_TYPE = "sensor_msgs/msg/Image"
COMPRESSED_TYPE = "sensor_msgs/msg/CompressedImage"
B_SCAN_TYPE = "navtech_msgs/msg/RadarBScanMsg"
B_SCAN_DEFINITION = "sensor_msgs/Image b_scan_img\nuint16[] encoder_values\nuint64[] timestamps\n"
"""Type and definition of the messages in which Navtech's driver sends polar scans; ROS itself does not define this type."""
FFT_NAMES = ("/RadarFftDataMessage", "/RadarFftDataMsg", "/FftDataMessage")
"""Endings of the names of message types that hold one azimuth; versions of Navtech's driver have different types."""
_FFT_TYPES = ("messages/msg/RadarFftDataMessage", "nav_messages/msg/RadarFftDataMsg")
_FFT_DEFINITION = "std_msgs/Header header\n" + "".join(
    f"uint8[] {name}\n"
    for name in ("angle", "azimuth", "sweep_counter", "ntp_seconds", "ntp_split_seconds", "data", "data_length")
)
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
POSE_TYPE = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE_TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"
PATH_TYPE = "nav_msgs/msg/Path"
RESULT_TOPICS = ("/path", "/pose")
"""The topics on which the bag of a run's results holds the poses: first without, then with their covariances."""
_TRUTH_NAME = re.compile(r"truth|(?<![a-z])gt(?![a-z])")
_MOST_METADATA_BYTES = 800_000  # limit on metadata.yaml; a day recorded in files of one minute has about 500,000
PoseRow = tuple[int, float, float, float]  # stamp [us], x [m], y [m], yaw [rad]
_OTHER_SCHEMAS = {
    "ros1msg": "of ROS 1 in an mcap",
    "protobuf": "in protobuf",
    "jsonschema": "in JSON",
    "flatbuffer": "in FlatBuffers",
}
_GIVE_ROS = "give the .bag that it was made from, or convert that .bag with rosbags-convert"
_UNPACK = {
    "zstd": "zstd -d FILE",
    "zst": "zstd -d FILE",
    "gz": "gunzip FILE",
    "bz2": "bunzip2 FILE",
    "xz": "unxz FILE",
    "lz4": "unlz4 FILE",
    "zip": "unzip FILE",
    "7z": "7z x FILE",
    "tar": "tar xf FILE",
    "tgz": "tar xf FILE",
}
_PACKED = re.compile(rf".*?(?P<what>\.(?:db3|mcap|bag))?\.(?P<how>{'|'.join(_UNPACK)})")
KINDS = {"rosbag1": ".bag", "mcap": ".mcap", "rosbag2": "", "rosbag2_mcap": ""}
"""Kinds of bags that can be written, by name, with the suffix of the file: a ROS 1 bag, an mcap file, and (with suffix "")
folders of ROS 2 with sqlite3 or mcap."""
RADAR_FRAME, VEHICLE_FRAME = "radar", "base_link"
"""Names of the frames of the radar and of the vehicle in every bag that is written."""
TF_TYPE = "tf2_msgs/msg/TFMessage"
_DEFINITIONS = {B_SCAN_TYPE: B_SCAN_DEFINITION, TF_TYPE: "geometry_msgs/TransformStamped[] transforms\n"}
_INVALID = "a quaternion of zeros, numbers that are not finite, or a place over 1e9 m away"
_LATEST_US = 2**31 * 1_000_000  # ROS 2 counts seconds in 31 bits [us]


def explain_packed(path: Path) -> DataError | None:
    """Returns the error for a file whose name ends like that of a packed file (.zst, .tar, .zip...), else None."""
    packed = _PACKED.fullmatch(path.name.lower())
    if packed is None or not path.is_file():
        return None
    unpack = f"unpack it, for example by '{_UNPACK[packed['how']]}'"
    if packed["how"].startswith("zst") and packed["what"] in (".db3", ".mcap"):
        return DataError(
            path, "is a packed file of a ROS 2 bag", f"give the bag's folder, with its metadata.yaml, or {unpack}"
        )
    logs = (
        "; only CARMEN logs are read packed, if their names end in .log.gz or .clf.gz"
        if packed["how"] == "gz" and not packed["what"]
        else ""
    )
    return DataError(path, "is packed", f"{unpack}, and give its content{logs}")


def recognises(path: Path) -> bool:
    """Returns whether the path is a file named `.bag`, `.mcap` or `.db3`, or a folder with a `metadata.yaml`."""
    return path.suffix in (".bag", ".mcap", ".db3") if path.is_file() else (path / "metadata.yaml").is_file()


@contextlib.contextmanager
def open_bag(path: Path) -> Iterator[AnyReader]:
    """Opens a bag and yields its reader.

    Args:
        path: a ROS 1 `.bag`, a ROS 2 folder, `.db3` or `.mcap`.

    Raises:
        DataError: the path cannot be read as a bag, or the block raises any error that is no MqslamError.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    for file in path.iterdir() if path.is_dir() else (path,):
        if not file.is_dir():
            untrusted.check_file(file)
    if (described := path / "metadata.yaml").is_file():
        untrusted.read_document(described, _MOST_METADATA_BYTES)
    bound_rosbags()
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(B_SCAN_DEFINITION, B_SCAN_TYPE))
    for name in _FFT_TYPES:
        store.register(get_types_from_msg(_FFT_DEFINITION, name))
    try:
        with AnyReader([path], default_typestore=store) as reader:
            yield reader
    except MqslamError:
        raise
    except Exception as error:  # on damaged files rosbags does not catch the errors of struct, zlib, apsw, yaml...
        if isinstance(error, KeyError) and error.args and (kind := _OTHER_SCHEMAS.get(error.args[0])):
            raise DataError(path, f"holds messages {kind}, not of ROS 2", _GIVE_ROS) from error
        reason = (str(error) or type(error).__name__).splitlines()[0]
        remedy = "copy the file again, or repair it with 'rosbag reindex' or 'mcap recover'"
        raise DataError(path, f"is not a readable bag ({reason})", remedy) from error


@contextlib.contextmanager
def name_message(path: Path, topic: str, logged_ns: int) -> Iterator[None]:
    """Turns a ValueError of the block into a DataError that names the bag, the topic and the time of recording [ns]."""
    try:
        yield
    except ValueError as error:
        remedy = CONVERT_IMAGES if isinstance(error, NotGreyError) else "remove it from the bag, or give another bag"
        raise DataError(path, f"the message on {topic} recorded at {logged_ns} ns {error}", remedy) from error


def deserialise(reader: AnyReader, connection: Connection, raw: bytes) -> Any:
    """Converts the bytes `raw`, recorded on a connection, to the message that they hold.

    Raises:
        ValueError: the message's bytes do not fit its type.
    """
    try:
        return reader.deserialize(raw, connection.msgtype)
    except Exception as error:  # the code that rosbags generates for a type raises the errors of struct and NumPy
        raise ValueError(f"is damaged ({str(error) or type(error).__name__})") from error


def list_topics(reader: AnyReader) -> str:
    """Returns at most twelve of a bag's topics with their types as a text for errors, or `none` for a bag without topics."""
    return ", ".join(f"{c.topic} [{c.msgtype}]" for c in reader.connections[:12]) or "none"


def require_topic(path: Path, topic: str, there: Iterable[Connection], what: str, kind: str) -> Connection:
    """Returns the connection of a topic that the user names.

    Args:
        path: path of the bag.
        topic: name of the topic.
        there: the connections to choose from.
        what: content that the topic should have, for the error, such as `polar scans`.
        kind: content of the messages on topics that fit, for the error, such as `images`.

    Raises:
        DataError: none of the connections has that topic; the error lists their topics, twelve at most.
    """
    by_topic = {connection.topic: connection for connection in reversed(list(there))}
    if topic not in by_topic:
        listed = ", ".join(sorted(by_topic)[:12])
        remedy = f"name one of its topics with {kind}: {listed}" if listed else f"name no topic: none has {kind}"
        raise DataError(path, f"has no {what} on {topic}", remedy)
    return by_topic[topic]


def is_truth(topic: str) -> bool:
    """Returns whether a topic is named like ground truth: its name contains "truth", or "gt" with no letter beside it."""
    return bool(_TRUTH_NAME.search(topic.lower()))


def name_frame(name: str) -> str:
    """Returns a frame's name as ROS 2 writes it: without the leading slash that ROS 1 allowed."""
    return name.lstrip("/")


def stamp_of(message: Any) -> int:
    """Returns the stamp [us] of a message's header; 0 means that the header has no stamp."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000 + int(stamp.nanosec) // 1000


@dataclass(slots=True)
class Clock:
    """Reads the stamps of a bag's messages: the stamp in the header or, if the header has none, the time of recording.

    Args:
        read: by topic, the number of messages whose stamps were read.
        unstamped: by topic, the number of messages whose headers have no stamp.
    """

    read: dict[str, int] = field(default_factory=dict)
    unstamped: dict[str, int] = field(default_factory=dict)

    def stamp(self, topic: str, message: Any, logged_ns: int) -> int:
        """Returns the stamp [us] of a message, and counts the message; `logged_ns` [ns] is the time of its recording."""
        stamp = stamp_of(message)
        self.read[topic] = self.read.get(topic, 0) + 1
        if not stamp:
            self.unstamped[topic] = self.unstamped.get(topic, 0) + 1
        return stamp or logged_ns // 1000

    @property
    def notes(self) -> list[str]:
        """Notes for the user about messages without stamps: one line per topic."""
        return [
            f"{'the' if count == self.read[topic] else f'{count} of {self.read[topic]}'} messages on {topic} "
            "have no stamps in their headers: the times at which they were recorded are used instead"
            for topic, count in self.unstamped.items()
        ]


@dataclass(slots=True)
class PoseLog:
    """The planar poses on the topics of a bag, which `add` collects one message at a time.

    Args:
        clock: reads the stamps of messages.
        rows: by topic, its poses in the order of the messages: stamp [us], x [m], y [m], yaw [rad].
        frames: by topic, the name of the frame whose poses the topic holds; "" if the messages do not name the frame, and no
            entry for a path.
    """

    clock: Clock = field(default_factory=Clock)
    rows: dict[str, list[PoseRow]] = field(default_factory=dict)
    frames: dict[str, str] = field(default_factory=dict)

    def add(self, reader: AnyReader, connection: Connection, logged_ns: int, raw: bytes) -> None:
        """Adds the pose of an odometry or pose message; the poses of a path replace all poses that the topic has so far."""
        topic = connection.topic
        message: Any = reader.deserialize(raw, connection.msgtype)
        if connection.msgtype == PATH_TYPE:
            self.rows[topic] = [_pose_of(pose.pose, stamp_of(pose)) for pose in message.poses]
            return
        pose = message.pose if connection.msgtype == POSE_TYPE else message.pose.pose
        self.rows.setdefault(topic, []).append(_pose_of(pose, self.clock.stamp(topic, message, logged_ns)))
        self.frames.setdefault(topic, getattr(message, "child_frame_id", ""))

    def trajectory(self, topic: str | None) -> Trajectory | None:
        """Returns the valid poses on a topic by increasing stamp; of poses with equal stamps, only the last added one.

        The result is None if the topic is None, or if its valid poses have fewer than two different stamps.
        """
        rows = {row[0]: row for row in self.rows.get(topic or "", ()) if mark_places(np.array(row[1:]))}
        if len(rows) < 2:
            return None
        kept = sorted(rows.values())
        return Trajectory(np.array([row[0] for row in kept], dtype=np.int64), np.array([row[1:] for row in kept]))

    def note_left_out(self, topic: str | None) -> list[str]:
        """Returns a list with a note for the user if `trajectory` leaves out a topic or some of its poses, else []."""
        rows = self.rows.get(topic or "", [])
        if rows and self.trajectory(topic) is None:
            return [f"{topic} is left out: it holds no two valid poses at different times"]
        left_out = sum(not mark_places(np.array(row[1:])) for row in rows)
        return describe_left_out(left_out, f"{left_out} of {count_of(len(rows), 'pose')} on {topic}")


def _pose_of(pose: Any, stamp_us: int) -> PoseRow:
    """Returns a `geometry_msgs/Pose` as a row with its stamp; the yaw is NaN if the quaternion is zero."""
    q = pose.orientation
    return stamp_us, pose.position.x, pose.position.y, yaw_of_quaternion(q.x, q.y, q.z, q.w)


def describe_left_out(count: int, which: str) -> list[str]:
    """Returns a list with the note that `count` invalid poses or transforms, named by `which`, are left out; [] for 0."""
    return [f"{which} {is_or_are(count)} left out: {_INVALID}"] if count else []


@dataclass(frozen=True, slots=True)
class Bag:
    """A bag that is being written, with functions that make its messages.

    Args:
        writer: the writer of rosbags, for ROS 1 or ROS 2.
        store: the message types that the writer knows.
        is_ros1: whether the writer is for ROS 1.
        out: where the finished bag will lie, for errors.
    """

    writer: Any
    store: Typestore
    is_ros1: bool
    out: Path

    def topic(self, name: str, message_type: str, *, latched: bool = False) -> Connection:
        """Adds a topic and returns its connection; late subscribers of a latched topic still get its last message."""
        kept: dict[str, Any] = {"latching": 1} if self.is_ros1 else {"offered_qos_profiles": [_make_latched_qos()]}
        connection: Connection = self.writer.add_connection(
            name, message_type, typestore=self.store, **(kept if latched else {})
        )
        return connection

    def write(self, connection: Connection, stamp_us: int, message: Any) -> None:
        """Writes a message on the topic of a connection, with a stamp [us] as its time of recording."""
        serialise = self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr
        self.writer.write(connection, stamp_us * 1000, serialise(message, connection.msgtype))

    def make(self, message_type: str, *fields: Any) -> Any:
        """Makes a message of a type from the values of its fields, in the order in which the type defines the fields."""
        return self.store.types[message_type](*fields)

    def header(self, stamp_us: int, frame: str) -> Any:
        """Makes the header of a message from its stamp [us] and its frame.

        Raises:
            OutputError: the stamp lies before 1970 or after 2038, which ROS cannot hold.
        """
        if not 0 <= stamp_us < _LATEST_US:
            raise OutputError(
                f"{self.out}: stamp {stamp_us} us is outside ROS's clock (1970 to 2038); write .npz or a folder"
            )
        stamp = self.make("builtin_interfaces/msg/Time", stamp_us // 1_000_000, stamp_us % 1_000_000 * 1000)
        return self.make("std_msgs/msg/Header", *((0, stamp, frame) if self.is_ros1 else (stamp, frame)))

    def vector(self, x: float, y: float, z: float) -> Any:
        """Makes a `geometry_msgs/Vector3` of three components."""
        return self.make("geometry_msgs/msg/Vector3", x, y, z)

    def quaternion(self, yaw: float) -> Any:
        """Makes a `geometry_msgs/Quaternion` of a yaw [rad]."""
        return self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))

    def transform(self, stamp_us: int, frames: tuple[str, str], pose: se2.Array) -> Any:
        """Makes a `tf2_msgs/TFMessage` of the pose (3,) x, y [m], yaw [rad] of the second of `frames` in the first."""
        x, y, yaw = pose.tolist()
        move = self.make("geometry_msgs/msg/Transform", self.vector(x, y, 0.0), self.quaternion(yaw))
        parent, child = frames
        return self.make(
            TF_TYPE, [self.make("geometry_msgs/msg/TransformStamped", self.header(stamp_us, parent), child, move)]
        )

    def pose(self, pose: se2.Array) -> Any:
        """Makes a `geometry_msgs/Pose` of a planar pose (3,): x, y [m], yaw [rad]."""
        x, y, yaw = pose.tolist()
        return self.make("geometry_msgs/msg/Pose", self.make("geometry_msgs/msg/Point", x, y, 0.0), self.quaternion(yaw))


@contextlib.contextmanager
def write_bag(out: Path, kind: str) -> Iterator[Bag]:
    """Yields a new bag of one of `KINDS` to write to; the bag replaces `out` when the block ends without an error.

    Raises:
        OutputError: the bag cannot be written.
    """
    if kind == "rosbag2" and set("?#%") & set(str(out)):
        raise OutputError(f"{out}: sqlite gives ?, # and % in a path a special meaning; choose another output")
    try:
        if KINDS[kind]:
            with write_aside(out) as aside, tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as folder:
                path = Path(folder) / out.name
                with _start_bag(path, kind, out) as bag:
                    yield bag
                (path if path.is_file() else next(path.glob("*.mcap"))).replace(aside)
        else:
            with write_folder_aside(out) as aside:
                inside = aside / out.name  # ROS 2 names the files in a bag after its folder
                with _start_bag(inside, kind, out) as bag:
                    yield bag
                for file in list(inside.iterdir()):
                    shutil.move(file, aside)
                inside.rmdir()
    except sqlite3.Error as error:
        raise OutputError(f"{out}: cannot be written ({error}); free space or choose another output") from error


@contextlib.contextmanager
def _start_bag(path: Path, kind: str, out: Path) -> Iterator[Bag]:
    """Opens a new bag at a path where nothing exists yet, and closes it when the block ends; errors name `out`."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    is_ros1 = kind == "rosbag1"
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    for message_type, definition in _DEFINITIONS.items():
        if message_type not in store.types:
            store.register(get_types_from_msg(definition, message_type))
    # some ROS 2 distributions that are still in use do not know version 9 of the metadata
    plugin = StoragePlugin.SQLITE3 if kind == "rosbag2" else StoragePlugin.MCAP
    with Writer1(path) if is_ros1 else Writer2(path, version=8, storage_plugin=plugin) as writer:
        yield Bag(writer, store, is_ros1, out)


def _make_latched_qos() -> Any:
    """Makes the quality of service (QoS) of a topic that keeps its last message for late subscribers."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    forever = QosTime(9_223_372_036, 854_775_807)
    keep, reliable, durable = QosHistory.KEEP_LAST, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL
    return Qos(keep, 1, reliable, durable, forever, forever, QosLiveliness.AUTOMATIC, forever, False)
