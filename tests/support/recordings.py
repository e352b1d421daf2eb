"""Small recordings written byte by byte, as other software writes them."""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mqslam.core import se2
from mqslam.core.recording import PolarScan, Recording
from mqslam.core.trajectory import Trajectory
from mqslam.formats.recordings import open_recording

START_US = 1_700_000_000_000_000
TURN_US = 250_000
KINDS = ("ros1", "ros2", "mcap")
B_SCAN = "sensor_msgs/Image b_scan_img\nuint16[] encoder_values\nuint64[] timestamps\n"
ODOMETRY_TOPIC = "/wheel/odom"
TRUTH_TOPIC = "/ground_truth/pose"


def oxford_rows(k: int, azimuths: int = 40, bins: int = 200) -> NDArray[np.uint8]:
    """Returns the image (azimuths, 11 + bins) of polar scan k: noise and two walls, one of them turning."""
    rng = np.random.default_rng(k)
    power = rng.integers(0, 40, (azimuths, bins), dtype=np.uint8)
    power[:, bins // 2] = 200
    power[(np.arange(3) + k) % azimuths, bins // 4] = 220
    stamp = START_US + k * TURN_US
    rows = np.arange(azimuths)
    ticks = 7 + rows * 5600 // azimuths
    return with_metadata(power, stamp + rows * TURN_US // azimuths, ticks, np.ones(azimuths, bool))


def with_metadata(
    power: NDArray[np.uint8], stamps_us: NDArray[np.int64], ticks: NDArray[np.int64], valid: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """Returns an image of Oxford rows."""
    return np.hstack(
        [
            stamps_us.astype("<i8").view(np.uint8).reshape(-1, 8),
            ticks.astype("<u2").view(np.uint8).reshape(-1, 2),
            np.where(valid, 255, 0).astype(np.uint8)[:, None],
            power,
        ]
    )


def write_oxford(folder: Path, polar_scans: int = 6, skip: tuple[int, ...] = ()) -> Path:
    """Writes a folder in the Oxford layout; the polar scans in `skip` are missing."""
    (folder / "radar").mkdir(parents=True)
    stamps = [START_US + k * TURN_US for k in range(polar_scans) if k not in skip]
    for stamp in stamps:
        write_png(folder, oxford_rows((stamp - START_US) // TURN_US))
    (folder / "radar.timestamps").write_text("".join(f"{stamp} 1\n" for stamp in stamps))
    return folder


def write_png(folder: Path, image: NDArray[np.uint8]) -> None:
    """Writes an image of Oxford rows under the stamp of its first row."""
    stamp = int(image[0, :8].copy().view("<i8")[0])
    Image.fromarray(image).save(folder / "radar" / f"{stamp}.png")


def circle(stamps_us: NDArray[np.int64]) -> Trajectory:
    """Returns a drive along an arc."""
    yaw = (stamps_us - stamps_us[0]) * 1e-7
    return Trajectory(stamps_us, np.column_stack([50 * np.sin(yaw), 50 * (1 - np.cos(yaw)), yaw]))


TF = "tf2_msgs/msg/TFMessage"


@dataclass
class Bag:
    """A bag being written: ROS 1, ROS 2 with sqlite, or a bare mcap."""

    writer: Writer1 | Writer2
    store: Any

    @property
    def is_ros1(self) -> bool:
        return isinstance(self.writer, Writer1)

    def topic(self, name: str, message_type: str) -> Connection:
        return self.writer.add_connection(name, message_type, typestore=self.store)

    def write(self, connection: Connection, stamp_us: int, message: Any) -> None:
        serialise = self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr
        self.writer.write(connection, stamp_us * 1000, serialise(message, connection.msgtype))

    def header(self, stamp_us: int, frame: str = "radar") -> Any:
        stamp = self.store.types["builtin_interfaces/msg/Time"](stamp_us // 1_000_000, stamp_us % 1_000_000 * 1000)
        header = self.store.types["std_msgs/msg/Header"]
        return header(0, stamp, frame) if self.is_ros1 else header(stamp, frame)

    def image(self, stamp_us: int, pixels: NDArray[np.uint8], encoding: str = "mono8") -> Any:
        height, width = pixels.shape
        data = np.ascontiguousarray(pixels).reshape(-1)
        image = self.store.types["sensor_msgs/msg/Image"]
        return image(self.header(stamp_us), height, width, encoding, 0, width, data)

    def compressed(self, stamp_us: int, pixels: NDArray[np.uint8], format: str) -> Any:
        packed = io.BytesIO()
        Image.fromarray(pixels).save(packed, format=format)
        data = np.frombuffer(packed.getvalue(), dtype=np.uint8)
        message = self.store.types["sensor_msgs/msg/CompressedImage"]
        return message(self.header(stamp_us), f"mono8; {format} compressed ", data)

    def b_scan(self, stamp_us: int, pixels: NDArray[np.uint8], ticks: Any, stamps_ns: Any) -> Any:
        b_scan = self.store.types["navtech_msgs/msg/RadarBScanMsg"]
        return b_scan(self.image(stamp_us, pixels), np.asarray(ticks, np.uint16), np.asarray(stamps_ns, np.uint64))

    def odometry(self, stamp_us: int, pose: NDArray[np.float64]) -> Any:
        types = self.store.types
        zero = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
        twist = types["geometry_msgs/msg/Twist"](zero, zero)
        return types["nav_msgs/msg/Odometry"](
            self.header(stamp_us),
            "base_link",
            types["geometry_msgs/msg/PoseWithCovariance"](self._pose(pose), np.zeros(36)),
            types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
        )

    def pose_stamped(self, stamp_us: int, pose: NDArray[np.float64]) -> Any:
        return self.store.types["geometry_msgs/msg/PoseStamped"](self.header(stamp_us), self._pose(pose))

    def transform(self, stamp_us: int, names: tuple[str, str], move: Any, turn: Any = (0.0, 0.0, 0.0, 1.0)) -> Any:
        """Makes a message with the place x, y, z and the quaternion x, y, z, w of the second frame in the first."""
        types = self.store.types
        vector = types["geometry_msgs/msg/Vector3"](*map(float, move))
        motion = types["geometry_msgs/msg/Transform"](vector, types["geometry_msgs/msg/Quaternion"](*map(float, turn)))
        parent, child = names
        return types[TF]([types["geometry_msgs/msg/TransformStamped"](self.header(stamp_us, parent), child, motion)])

    def scan(self, stamp_us: int, ranges: Any = (1, 2, 3, 4, 5), intensities: Any = (), **changed: float) -> Any:
        """Makes a lidar's scan that begins at -1 rad, in steps of 0.5 rad, in the frame called radar."""
        limits = {"angle_min": -1.0, "angle_max": 1.0, "angle_increment": 0.5, "time_increment": 1e-3, "scan_time": 0.1}
        limits |= {"range_min": 0.1, "range_max": 30.0, **changed}
        ranges, intensities = (np.asarray(numbers, np.float32) for numbers in (ranges, intensities))
        scan = self.store.types["sensor_msgs/msg/LaserScan"]
        return scan(header=self.header(stamp_us), ranges=ranges, intensities=intensities, **limits)

    def _pose(self, pose: NDArray[np.float64]) -> Any:
        x, y, yaw = pose
        point = self.store.types["geometry_msgs/msg/Point"](x, y, 0.0)
        turned = self.store.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
        return self.store.types["geometry_msgs/msg/Pose"](point, turned)


class bag_writer:
    """A context in which a bag of a kind is written; it leaves `path` behind."""

    def __init__(self, path: Path, kind: str) -> None:
        self.path, self.kind = path, kind
        self.folder = path.with_name(path.name + ".parts") if kind == "mcap" else path
        store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
        store.register(get_types_from_msg(B_SCAN, "navtech_msgs/msg/RadarBScanMsg"))
        if TF not in store.types:
            store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", TF))
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer = Writer1(path) if kind == "ros1" else Writer2(self.folder, version=8, storage_plugin=plugin)
        self.bag = Bag(writer, store)

    def __enter__(self) -> Bag:
        self.bag.writer.open()
        return self.bag

    def __exit__(self, *error: object) -> None:
        self.bag.writer.close()
        if self.kind == "mcap":
            next(self.folder.glob("*.mcap")).rename(self.path)
            shutil.rmtree(self.folder)


def bag_path(folder: Path, kind: str) -> Path:
    """Returns the path that users usually give to a bag of a kind."""
    return folder / {"ros1": "drive.bag", "ros2": "drive_ros2", "mcap": "drive.mcap"}[kind]


def raw_rows(recording: Recording) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Yields the stamp [us] and the Oxford rows of every polar scan of a recording."""
    for stamp, polar_scan in zip(recording.stamps_us.tolist(), recording.polar_scans(), strict=True):
        stamps = recording.start_us + np.round(polar_scan.times * 1e6).astype(np.int64)
        ticks = np.round(-polar_scan.azimuths * 5600 / (2 * np.pi)).astype(np.int64)
        yield stamp, with_metadata(polar_scan.power, stamps, ticks, polar_scan.valid)


def write_bag(recording: Recording, path: Path, kind: str, topic: str = "/Navtech/Polar") -> Path:
    """Writes a recording as a bag of Oxford rows in mono8 images, with its odometry and ground truth where it has any."""
    with bag_writer(path, kind) as bag:
        radar = bag.topic(topic, "sensor_msgs/msg/Image")
        messages = [(stamp, radar, bag.image(stamp, rows)) for stamp, rows in raw_rows(recording)]
        for trajectory, name in ((recording.odometry, ODOMETRY_TOPIC), (recording.ground_truth, TRUTH_TOPIC)):
            if trajectory is None:
                continue
            odometry = bag.topic(name, "nav_msgs/msg/Odometry")
            for stamp, pose in zip(trajectory.stamps_us.tolist(), trajectory.poses, strict=True):
                messages.append((stamp, odometry, bag.odometry(stamp, pose)))
        for stamp, connection, message in sorted(messages, key=lambda entry: entry[0]):
            bag.write(connection, stamp, message)
    return path


def write_turns(
    oxford: Path,
    path: Path,
    kind: str,
    make: Callable[[Bag, int, NDArray[np.uint8]], Any],
    topic: str = "/Navtech/Polar",
    late_us: int = 0,
) -> Recording:
    """Writes one message for each polar scan of a folder, made of its stamp and rows, and opens the bag."""
    with bag_writer(path, kind) as bag:
        connection = None
        for stamp, rows in raw_rows(open_recording(oxford)):
            message = make(bag, stamp + late_us, rows)
            connection = connection or bag.topic(topic, message.__msgtype__)
            bag.write(connection, stamp + late_us, message)
    return open_recording(path)


def assert_same(a: Recording, b: Recording) -> None:
    """Checks that two recordings hold identical polar scans at identical stamps."""
    np.testing.assert_array_equal(a.stamps_us, b.stamps_us)
    assert a.end_us == b.end_us
    for one, other in zip(a.polar_scans(), b.polar_scans(), strict=True):
        assert_same_polar_scan(one, other)


def assert_same_track(result: Trajectory, expected: Trajectory, atol: float = 2e-6) -> None:
    """Checks that two trajectories have the same stamps, and poses that differ by at most `atol` [m, rad]."""
    np.testing.assert_array_equal(result.stamps_us, expected.stamps_us)
    np.testing.assert_allclose(result.poses[:, :2], expected.poses[:, :2], atol=atol)
    np.testing.assert_allclose(se2.wrap(result.poses[:, 2] - expected.poses[:, 2]), 0.0, atol=atol)


def assert_same_polar_scan(a: PolarScan, b: PolarScan) -> None:
    """Checks that two polar scans are identical, bit by bit."""
    for name in ("times", "azimuths", "power", "valid"):
        one, other = getattr(a, name), getattr(b, name)
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other, err_msg=name)
