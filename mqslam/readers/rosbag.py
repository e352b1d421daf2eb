"""ROS recordings: ROS 1 `.bag`, ROS 2 bag folder or `.db3`, `.mcap`; radar images, odometry and ground truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError
from mqslam.readers import bags, polar_message
from mqslam.readers.polar_message import B_SCAN_DEFINITION, B_SCAN_TYPE, IMAGE_TYPE, Layout
from mqslam.readers.rows import even_azimuths
from mqslam.readers.sensing import Sensing
from mqslam.stream import RadarStream, Revolution

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

RANGE_RESOLUTION_M = 0.0438
_POLAR_TOPICS = ("/navtech/polar", "/radar/polar")
_USUAL_TURN_US = 250_000
_DEFINITIONS = {B_SCAN_TYPE: B_SCAN_DEFINITION}


@dataclass(frozen=True, kw_only=True)
class RosbagStream(RadarStream):
    """A recording in a ROS bag; the bag is opened anew by every call of `revolutions`.

    Args:
        topic: the radar's topic.
        layout: how its messages hold their azimuths.
        logged_ns: (N,) int64 [ns], when the message of each revolution was recorded.
    """

    topic: str
    layout: Layout
    logged_ns: NDArray[np.int64]

    def revolutions(self, start: int = 0, stop: int | None = None) -> Iterator[Revolution]:
        """Read the revolutions start <= k < stop, one after the other."""
        wanted = range(len(self))[start:stop]
        if not wanted:
            return
        k = wanted.start
        with bags.opened(self.path, _DEFINITIONS) as reader:
            connections = [connection for connection in reader.connections if connection.topic == self.topic]
            first, after = int(self.logged_ns[k]), int(self.logged_ns[wanted[-1]]) + 1
            for connection, logged, raw in reader.messages(connections, first, after):
                message = reader.deserialize(raw, connection.msgtype)
                with bags.naming(self.path, self.topic, logged):
                    if _stamp_us(self.layout, message, logged) != self.stamps_us[k]:
                        continue
                    revolution = self._revolution(k, message)
                yield revolution
                k += 1
                if k == wanted.stop:
                    return
        raise DataError(self.path, f"revolution {k} on {self.topic} is gone", "the bag changed since it was opened")

    def _revolution(self, k: int, message: Any) -> Revolution:
        power = polar_message.power_of(self.layout, message)
        if self.layout.stamps_azimuths:
            azimuths = polar_message.stamped_azimuths(self.layout, message)
        else:
            stamp, period = int(self.stamps_us[k]), round(self.period_s * 1e6)
            until_next = int(self.stamps_us[k + 1] if k + 1 < len(self) else self.end_us) - stamp
            duration = until_next if until_next < 1.5 * period else period
            azimuths = even_azimuths(len(power), stamp, duration)
        return azimuths.revolution(power, self.start_us)


def recognises(path: Path) -> bool:
    """Whether the path is a `.bag`, `.mcap` or `.db3` file, or a folder with a `metadata.yaml`."""
    return bags.recognises(path)


def open_stream(path: Path, sensing: Sensing) -> RosbagStream:
    """Index a bag: one pass over the messages of radar, odometry and ground truth, of which only stamps and poses stay.

    Raises:
        DataError: not a readable bag, no radar topic in it, or a radar message that cannot be used.
    """
    with bags.opened(path, _DEFINITIONS) as reader:
        topic, layout, notes = _radar_topic(path, reader)
        odometry_topic, truth_topic = _pose_topics(reader)
        index = _index(path, reader, topic, layout, {odometry_topic, truth_topic} - {None})
    if index.skipped:
        notes.append(f"{index.skipped} messages on {topic} do not follow the one before in time: skipped")
    stamps = np.array(index.stamps_us, dtype=np.int64)
    if layout.stamps_azimuths:
        end_us = index.end_us
    else:
        end_us = int(stamps[-1]) + (round(float(np.median(np.diff(stamps)))) if len(stamps) > 1 else _USUAL_TURN_US)
        notes.append(
            "images carry no azimuth times or angles: header stamps are taken as the start of a revolution, "
            f"{layout.value} as azimuths spaced evenly clockwise from straight ahead"
        )
    if sensing.range_resolution is None:
        notes.append(f"range resolution {RANGE_RESOLUTION_M} m assumed: --range-resolution overrides it")
    odometry, truth = (bags.trajectory_of(index.poses.get(name or "", ())) for name in (odometry_topic, truth_topic))
    if odometry is not None:
        notes.append(f"odometry from {odometry_topic}, taken as the motion of the radar itself")
    if truth is not None:
        notes.append(f"ground truth from {truth_topic}, taken as the pose of the radar itself")
    return RosbagStream(
        path=path,
        format="rosbag",
        stamps_us=stamps,
        end_us=end_us,
        range_resolution=sensing.range_resolution or RANGE_RESOLUTION_M,
        odometry=odometry,
        ground_truth=truth,
        notes=tuple(notes),
        topic=topic,
        layout=layout,
        logged_ns=np.array(index.logged_ns, dtype=np.int64),
    )


@dataclass(slots=True)
class _Index:
    """What one pass over a bag collects: revolutions kept, the end of the last, and poses (t, x, y, yaw) by topic."""

    stamps_us: list[int] = field(default_factory=list)
    logged_ns: list[int] = field(default_factory=list)
    end_us: int = 0
    skipped: int = 0
    poses: dict[str, list[bags.PoseRow]] = field(default_factory=dict)


def _radar_topic(path: Path, reader: AnyReader) -> tuple[str, Layout, list[str]]:
    """The radar's topic, the layout of its messages, and a note on the choice."""
    filled = [connection for connection in reader.connections if connection.msgcount]
    images = [connection for connection in filled if connection.msgtype == IMAGE_TYPE]
    named = [c for suffix in _POLAR_TOPICS for c in images if c.topic.lower().endswith(suffix)]
    named += [connection for connection in filled if connection.msgtype == B_SCAN_TYPE]
    if named:
        chosen, note = named[0], f"radar from {named[0].topic}"
    else:
        alike = {c.topic: c for c in images if polar_message.looks_like_radar(_first(reader, c)[1])}
        if len(alike) != 1:
            raise DataError(
                path,
                f"has {'several topics that could be' if alike else 'no'} radar (topics: {bags.topics_there(reader)})",
                f"radar is {IMAGE_TYPE} on /Navtech/Polar or /radar/polar, or {B_SCAN_TYPE}",
            )
        chosen = next(iter(alike.values()))
        note = f"radar from {chosen.topic}, the only topic with images shaped like a radar's"
    logged, message = _first(reader, chosen)
    with bags.naming(path, chosen.topic, logged):
        return chosen.topic, polar_message.layout_of(chosen.topic, chosen.msgtype, message), [note]


def _first(reader: AnyReader, connection: Connection) -> tuple[int, Any]:
    """When the first message of a connection was recorded [ns], and the message."""
    _, logged, raw = next(reader.messages([connection]))
    return logged, reader.deserialize(raw, connection.msgtype)


def _pose_topics(reader: AnyReader) -> tuple[str | None, str | None]:
    """The topics of odometry and of ground truth, by type and name."""
    typed = [c for c in reader.connections if c.msgtype in (bags.ODOMETRY_TYPE, bags.POSE_TYPE)]
    truths = [c.topic for c in typed if bags.TRUTH_NAME.search(c.topic.lower())]
    drives = [c.topic for c in typed if c.msgtype == bags.ODOMETRY_TYPE and c.topic not in truths]
    drives.sort(key=lambda topic: "odom" not in topic.lower())
    return next(iter(drives), None), next(iter(truths), None)


def _index(path: Path, reader: AnyReader, topic: str, layout: Layout, pose_topics: set[str | None]) -> _Index:
    """One pass over the messages of the radar and of the pose topics."""
    index = _Index()
    last: Any = None
    connections = [c for c in reader.connections if c.topic == topic or c.topic in pose_topics]
    for connection, logged, raw in reader.messages(connections):
        message: Any = reader.deserialize(raw, connection.msgtype)
        if connection.topic != topic:
            index.poses.setdefault(connection.topic, []).append(bags.pose_row(connection.msgtype, message))
            continue
        with bags.naming(path, topic, logged):
            stamp = _stamp_us(layout, message, logged)
        if index.stamps_us and stamp <= index.stamps_us[-1]:
            index.skipped += 1
            continue
        index.stamps_us.append(stamp)
        index.logged_ns.append(logged)
        last = message
    if layout.stamps_azimuths:
        index.end_us = polar_message.stamped_azimuths(layout, last).end_us
    return index


def _stamp_us(layout: Layout, message: Any, logged_ns: int) -> int:
    """Stamp [us] of a message's first azimuth: its own, else the header's, else when it was recorded."""
    if layout.stamps_azimuths:
        return int(polar_message.stamped_azimuths(layout, message).stamps_us[0])
    polar_message.pixels(message)
    return bags.header_us(message) or logged_ns // 1000
