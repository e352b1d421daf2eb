"""Writes recordings as ROS bags: radar on /Navtech/Polar or /radar_data/b_scan_msg, odometry, and ground truth."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from mqslam.core.recording import PolarScan, Recording
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.shared.azimuth_rows import has_metadata
from mqslam.formats.shared.bags import ODOMETRY_TYPE
from mqslam.formats.shared.polar_message import B_SCAN_TYPE, ENCODER_TURNS, IMAGE_TYPE
from mqslam.formats.writing.azimuth_rows import azimuth_stamps, encoder_ticks, oxford_rows
from mqslam.formats.writing.bags import Bag, bag_written

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

Message = Literal["image", "b_scan"]
ODOMETRY_TOPIC = "/odom"
TRUTH_TOPIC = "/ground_truth"
RADAR_FRAME = "radar"
_TOPICS = {"image": ("/Navtech/Polar", IMAGE_TYPE), "b_scan": ("/radar_data/b_scan_msg", B_SCAN_TYPE)}
_Entry = tuple[int, "Connection", Any]  # stamp [us], topic, message
_Made = Callable[[Bag, Recording, int, PolarScan], Any]


def write(out: Path, recording: Recording, kind: str, message: Message) -> None:
    """Write a recording as a bag, one revolution in memory at a time.

    Args:
        out: the file or folder.
        recording: the recording.
        kind: one of `mqslam.formats.writing.bags.KINDS`.
        message: `image` for mono8 images whose rows begin with time, angle and validity, as in the Oxford layout;
            `b_scan` for the driver's own messages, which do not say whether an azimuth was measured.

    Raises:
        DataError: a revolution that cannot be read or that a bag cannot hold.
        OutputError: the bag cannot be written.
    """
    with bag_written(out, kind) as bag:
        sources = [_turns(bag, recording, _image if message == "image" else _b_scan, *_TOPICS[message])]
        if recording.odometry is not None:
            sources.append(_poses(bag, recording.odometry, ODOMETRY_TOPIC, "odom"))
        if recording.ground_truth is not None:
            sources.append(_poses(bag, recording.ground_truth, TRUTH_TOPIC, "map"))
        for stamp, connection, content in heapq.merge(*sources, key=lambda entry: entry[0]):
            bag.write(connection, stamp, content)


def _turns(bag: Bag, recording: Recording, made: _Made, topic: str, message_type: str) -> Iterator[_Entry]:
    """The revolutions as messages, stamped by their first azimuths."""
    connection = bag.topic(topic, message_type)
    for k, polar_scan in enumerate(recording.polar_scans()):
        yield int(azimuth_stamps(recording, polar_scan)[0]), connection, made(bag, recording, k, polar_scan)


def _poses(bag: Bag, track: Trajectory, topic: str, frame: str) -> Iterator[_Entry]:
    """Poses of the radar in a fixed frame as odometry messages, each with the mean twist until the next."""
    connection = bag.topic(topic, ODOMETRY_TYPE)
    twists = track.mean_twists(track.stamps_us[:-1], track.stamps_us[1:])
    unknown = np.zeros(36)
    for stamp, pose, (vx, vy, omega) in zip(
        track.stamps_us.tolist(), track.poses, np.vstack([twists, twists[-1:]]).tolist(), strict=True
    ):
        twist = bag.make("geometry_msgs/msg/Twist", bag.vector(vx, vy, 0.0), bag.vector(0.0, 0.0, omega))
        message = bag.make(
            ODOMETRY_TYPE,
            bag.header(stamp, frame),
            RADAR_FRAME,
            bag.make("geometry_msgs/msg/PoseWithCovariance", bag.pose(pose), unknown),
            bag.make("geometry_msgs/msg/TwistWithCovariance", twist, unknown),
        )
        yield stamp, connection, message


def _image(bag: Bag, recording: Recording, k: int, polar_scan: PolarScan) -> Any:
    """Revolution k as a mono8 image of Oxford rows."""
    rows = oxford_rows(recording, k, polar_scan)
    if k == 0 and not has_metadata(rows):
        problem = "its first revolution is under half a turn, by which readers know rows with times and angles"
        raise DataError(recording.path, problem, "use --message b_scan, or convert it to oxford or .npz")
    return _mono8(bag, int(azimuth_stamps(recording, polar_scan)[0]), rows)


def _b_scan(bag: Bag, recording: Recording, k: int, polar_scan: PolarScan) -> Any:
    """Revolution k as a message of Navtech's driver, by the encoder its azimuths fit best."""
    stamps = azimuth_stamps(recording, polar_scan)
    ticks = encoder_ticks(recording, k, polar_scan, _encoder(polar_scan))
    image = _mono8(bag, int(stamps[0]), np.ascontiguousarray(polar_scan.power))
    return bag.make(B_SCAN_TYPE, image, ticks.astype(np.uint16), (stamps * 1000).astype(np.uint64))


def _encoder(polar_scan: PolarScan) -> int:
    """Ticks per turn of the encoder: the usual, unless azimuths lie on a finer one's only and values show which it is."""
    usual, fine = ENCODER_TURNS
    turns = -polar_scan.azimuths / (2.0 * np.pi)
    on_usual, on_fine = (np.allclose(turns * t, np.round(turns * t), rtol=0.0, atol=1e-6) for t in (usual, fine))
    shows = bool(np.max(np.round(turns * fine) % fine) > usual)
    return fine if on_fine and shows and not on_usual else usual


def _mono8(bag: Bag, stamp_us: int, pixels: NDArray[np.uint8]) -> Any:
    height, width = pixels.shape
    header = bag.header(stamp_us, RADAR_FRAME)
    return bag.make(IMAGE_TYPE, header, height, width, "mono8", 0, width, pixels.reshape(-1))
