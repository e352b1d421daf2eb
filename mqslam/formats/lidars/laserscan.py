"""Reads lidar scans (`sensor_msgs/LaserScan`) from ROS bags: ROS 1 `.bag`, ROS 2 folder or `.db3`, `.mcap`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mqslam.core.recording import LidarRecording, stamp_scans
from mqslam.core.scans import Returns
from mqslam.core.wording import count_of
from mqslam.errors import DataError
from mqslam.formats import bags
from mqslam.formats.bags import ODOMETRY_TYPE, POSE_TYPE, POSE_WITH_COVARIANCE_TYPE
from mqslam.formats.stamps import mark_increasing
from mqslam.formats.transforms import Mounts

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

# The times that a driver states for a lidar's beams are used if the beams of a scan span less than this many times the usual
# time from one scan to the next. A longer span is a mistake of the driver.
_LIDAR_LONGEST_SWEEP = 1.05

SCAN_TYPE = "sensor_msgs/msg/LaserScan"
_COMMANDS = ("goal", "initialpose", "initial_pose")


@dataclass(slots=True)
class _ScanIndex:
    """The scans, poses and transforms of a bag, as one pass over its messages reads them.

    Args:
        stamps_us: stamp of each scan [us].
        scans: the returns of each scan, whose times [s] count from the scan's stamp.
        poses: the poses on the topics of odometry and of a SLAM system.
        sensor_frame: name of the lidar's frame.
        mounts: the transforms that never change.
    """

    stamps_us: list[int] = field(default_factory=list)
    scans: list[Returns] = field(default_factory=list)
    poses: bags.PoseLog = field(default_factory=bags.PoseLog)
    sensor_frame: str = ""
    mounts: Mounts = field(default_factory=Mounts)


_OF_RADAR = ("polar", "navtech", "radar_data")  # parts of the names that drivers give to a radar's topics


def holds_scans(reader: AnyReader) -> bool:
    """Returns whether an open bag has laser scans and no topic that is named like a radar's."""
    kinds = {connection.msgtype for connection in reader.connections}
    topics = [connection.topic.lower() for connection in reader.connections]
    return SCAN_TYPE in kinds and not any(word in topic for topic in topics for word in _OF_RADAR)


def read_lidar(path: Path) -> LidarRecording:
    """Reads the scans of a bag, with its odometry and the poses that some SLAM system published.

    Ranges that are infinite, NaN or outside (range_min, range_max) are no returns. Beam k is measured k time increments
    after the header's stamp, unless these times cannot be true (see `_find_times`). If /tf_static, or a transform on /tf
    that never changes, states the lidar's mount, poses of the robot are converted to poses of the lidar, and the angles of a
    lidar that is mounted upside down are mirrored.

    Raises:
        DataError: the bag cannot be read, has no single topic of scans (see `_choose_topic`), has fewer than two scans whose
            stamps increase, or no scan has a return.
    """
    with bags.open_bag(path) as reader:
        topic = _choose_topic(path, reader)
        odometry_topic, pose_topic = _choose_pose_topics(reader)
        index = _read_index(path, reader, topic, {odometry_topic, pose_topic})
    rows = np.flatnonzero(mark_increasing(index.stamps_us)).tolist()
    stamps = np.array(index.stamps_us, dtype=np.int64)[rows]
    scans = [index.scans[row] for row in rows]
    if len(scans) < 2 or not any(map(len, scans)):
        held = f"{count_of(len(scans), 'scan')} with increasing stamps and {count_of(sum(map(len, scans)), 'return')}"
        problem = f"has {held} on {topic}: too few"
        raise DataError(path, problem, "give a bag with at least two scans, and returns in them")
    notes = [f"scans from {topic}", *index.poses.clock.notes]
    if dropped := len(index.scans) - len(scans):
        notes.append(f"{count_of(dropped, 'scan')} with a stamp that repeats or runs backward: left out")
    body = index.poses.frames.get(odometry_topic or "", "")
    mount = index.mounts.find(index.sensor_frame, body)
    stated = index.mounts.find_topic(index.sensor_frame) or "/tf_static"
    upside_down = index.mounts.is_upside_down(index.sensor_frame, body)
    if upside_down:
        notes.append(f"the lidar is mounted upside down, as {stated} states it: its angles are mirrored")
    times, noted = _find_times(stamps, scans)
    scans = [
        Returns(scan.ranges, -scan.azimuths if upside_down else scan.azimuths, time, scan.intensities)
        for scan, time in zip(scans, times, strict=True)
    ]
    notes += noted
    carried = {}
    for what, name in (("odometry", odometry_topic), ("trajectory", pose_topic)):
        track = index.poses.trajectory(name)
        notes += index.poses.note_left_out(name)
        if track is not None:
            how = "taken as the lidar's own motion" if mount is None else f"converted to poses of the lidar by {stated}"
            notes.append(f"{what} from {name}, {how}")
            carried[what] = track if mount is None else track.attach(mount)
    timed = stamp_scans(stamps, scans)
    return LidarRecording.of(path, "laserscan", timed, carried.get("trajectory"), carried.get("odometry"), tuple(notes))


def _choose_topic(path: Path, reader: AnyReader) -> str:
    """Chooses the topic of scans: the only one or, of several, the only `.../scan`; raises a DataError if there is none."""
    topics = sorted({c.topic for c in reader.connections if c.msgtype == SCAN_TYPE and c.msgcount})
    if not topics:
        raise DataError(path, f"has no scans (topics: {bags.list_topics(reader)})", f"give a bag with {SCAN_TYPE}")
    named = [topic for topic in topics if topic.rsplit("/", 1)[-1].lower() == "scan"] if len(topics) > 1 else topics
    if len(named) != 1:
        remedy = "give a bag with only one such topic, or with only one that is named scan"
        raise DataError(path, f"has several topics of scans ({', '.join(topics[:12])})", remedy)
    return named[0]


def _choose_pose_topics(reader: AnyReader) -> tuple[str | None, str | None]:
    """Chooses the topics of odometry and of a SLAM system's poses; None where no such topic has two messages.

    Topics of ground truth hold no odometry; of the others, those whose names contain `odom` are preferred. Topics of
    commands, such as goals, hold no poses of a SLAM system; of the others, those that are not ground truth are preferred. Of
    several preferred topics, the one with most messages is chosen.
    """
    filled = sorted((c for c in reader.connections if c.msgcount > 1), key=lambda c: -c.msgcount)
    drives = [c.topic for c in filled if c.msgtype == ODOMETRY_TYPE and not bags.is_truth(c.topic)]
    drives.sort(key=lambda topic: "odom" not in topic.lower())
    poses = [c.topic for c in filled if c.msgtype in (POSE_TYPE, POSE_WITH_COVARIANCE_TYPE)]
    poses = [topic for topic in poses if not any(word in topic.lower() for word in _COMMANDS)]
    poses.sort(key=bags.is_truth)
    return next(iter(drives), None), next(iter(poses), None)


def _read_index(path: Path, reader: AnyReader, topic: str, pose_topics: set[str | None]) -> _ScanIndex:
    """Reads the messages with scans, poses and transforms in one pass over a bag."""
    index = _ScanIndex()
    connections = [c for c in reader.connections if c.topic == topic or c.topic in pose_topics or Mounts.reads(c)]
    for connection, logged, raw in reader.messages(connections):
        if connection.topic in pose_topics:
            index.poses.add(reader, connection, logged, raw)
            continue
        message: Any = reader.deserialize(raw, connection.msgtype)
        if connection.topic == topic:
            with bags.name_message(path, topic, logged):
                index.scans.append(_parse_scan(message))
            index.stamps_us.append(index.poses.clock.stamp(topic, message, logged))
            index.sensor_frame = message.header.frame_id
        else:
            index.mounts.add(message, connection.topic)
    return index


def _parse_scan(message: Any) -> Returns:
    """Converts a `sensor_msgs/LaserScan` to the returns of a scan, whose times [s] count from the message's stamp.

    Raises:
        ValueError: an angle or time increment is not finite, or range_min is not below range_max.
    """
    numbers = (message.angle_min, message.angle_increment, message.time_increment)
    if not np.isfinite(numbers).all() or not message.range_min < message.range_max:
        raise ValueError(f"has unusable angles {numbers[:2]}, times or ranges ({message.range_min}, {message.range_max})")
    ranges = np.asarray(message.ranges, dtype=np.float64)
    intensities = np.asarray(message.intensities, dtype=np.float64)
    beams = np.arange(len(ranges))
    seen = np.isfinite(ranges) & (ranges > message.range_min) & (ranges < message.range_max)
    return Returns(
        ranges[seen],
        message.angle_min + message.angle_increment * beams[seen],
        message.time_increment * beams[seen],
        intensities[seen] if len(intensities) == len(ranges) else np.zeros(np.count_nonzero(seen)),
    )


def _find_times(stamps: NDArray[np.int64], scans: Sequence[Returns]) -> tuple[list[NDArray[np.float64]], list[str]]:
    """Returns the times [s] of the beams of N scans since the first stamp, and a list with a note if they are replaced.

    The N scans have stamps (N,) [us], from which the times in `scans` count [s]. These times are replaced if the driver's
    time increment is zero, is negative, or lets a scan last longer than the usual time until the next scan. Then all beams
    of a scan get the time of the scan's stamp.
    """
    starts = ((stamps - stamps[0]) * 1e-6).tolist()
    times = np.concatenate([scan.times for scan in scans])
    sweep = float(times.max() if times.min() >= 0.0 else times.min())
    if 0.0 < sweep < _LIDAR_LONGEST_SWEEP * float(np.median(np.diff(starts))):
        return [start + scan.times for start, scan in zip(starts, scans, strict=True)], []
    note = "no time of their own" if sweep == 0.0 else f"impossible times (a sweep of {sweep:.3g} s)"
    return (
        [np.full(len(scan), start) for start, scan in zip(starts, scans, strict=True)],
        [f"beams have {note}: all beams of a scan get the scan's time"],
    )
