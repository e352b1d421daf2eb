"""ROS recordings: ROS 1 `.bag`, ROS 2 bag folder or `.db3`, `.mcap`; radar images, odometry and ground truth."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mqslam.core.recording import PolarScan, Recording
from mqslam.errors import DataError
from mqslam.formats.shared import bags, polar_message
from mqslam.formats.shared.arrivals import smooth_arrivals
from mqslam.formats.shared.azimuth_rows import even_azimuths, spread_note
from mqslam.formats.shared.polar_message import B_SCAN_DEFINITION, B_SCAN_TYPE, COMPRESSED_TYPE, IMAGE_TYPE, Layout
from mqslam.formats.shared.sensing import Sensing
from mqslam.formats.shared.stamps import in_order
from mqslam.formats.shared.turns import find_usual_turns, place_turns

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

RANGE_RESOLUTION_M = 0.0438
_FIRST_TRIED = 10  # messages of a topic, of which one at least must be a revolution
_DEFINITIONS = {B_SCAN_TYPE: B_SCAN_DEFINITION}


@dataclass(frozen=True, kw_only=True)
class RosbagRecording(Recording):
    """A recording in a ROS bag; the bag is opened anew by every call of `revolutions`.

    Args:
        topic: the radar's topic.
        layout: how its messages hold their azimuths.
        messages_us: (N,) int64 [us], what the message of each revolution is stamped, be it the start or the end of it.
        logged_ns: (N,) int64 [ns], when the message of each revolution was recorded.
        clockwise: whether azimuths without stamps and angles of their own follow one another clockwise, seen from above.
    """

    topic: str
    layout: Layout
    messages_us: NDArray[np.int64]
    logged_ns: NDArray[np.int64]
    clockwise: bool

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Read the revolutions start <= k < stop, one after the other."""
        wanted = range(len(self))[start:stop]
        if not wanted:
            return
        k = wanted.start
        with bags.opened(self.path, _DEFINITIONS) as reader:
            connections = [connection for connection in reader.connections if connection.topic == self.topic]
            first, after = int(self.logged_ns[k]), int(self.logged_ns[wanted[-1]]) + 1
            for connection, logged, raw in reader.messages(connections, first, after):
                try:
                    message = bags.deserialised(reader, connection, raw)
                    if _stamp_us(self.layout, message, logged) != self.messages_us[k]:
                        continue
                except ValueError:  # the index left it out, too
                    continue
                with bags.naming(self.path, self.topic, logged):
                    polar_scan = self._polar_scan(k, message)
                yield polar_scan
                k += 1
                if k == wanted.stop:
                    return
        raise DataError(self.path, f"revolution {k} on {self.topic} is gone", "the bag changed since it was opened")

    def _polar_scan(self, k: int, message: Any) -> PolarScan:
        power = polar_message.power_of(self.layout, message)
        if self.layout.stamps_azimuths:
            azimuths = polar_message.stamped_azimuths(self.layout, message)
        else:
            begin, duration = int(self.stamps_us[k]), int(self.turns_us[k])
            azimuths = even_azimuths(len(power), begin, duration, clockwise=self.clockwise)
        return azimuths.polar_scan(power, self.start_us)


def recognises(path: Path) -> bool:
    """Whether the path is a `.bag`, `.mcap` or `.db3` file, or a folder with a `metadata.yaml`."""
    return bags.recognises(path)


def open_recording(path: Path, sensing: Sensing) -> RosbagRecording:
    """Index a bag: one pass over the messages of radar, odometry and ground truth, of which only stamps and poses stay.

    Raises:
        DataError: not a readable bag, no radar topic in it, or a radar message that cannot be used.
    """
    with bags.opened(path, _DEFINITIONS) as reader:
        topic, layout, notes = _radar_topic(path, reader)
        odometry_topic, truth_topic = _pose_topics(reader)
        index = _index(path, reader, topic, layout, {odometry_topic, truth_topic} - {None})
    ordered = in_order(index.stamps_us)
    messages_us = np.array(index.stamps_us, dtype=np.int64)[ordered]
    faults = [f"{index.unread} messages on {topic} could not be read, left out: {index.error}"] if index.unread else []
    if skipped := len(ordered) - len(messages_us):
        faults.append(f"the stamps of {skipped} messages on {topic} repeat or run backward: left out")
    clockwise = sensing.clockwise is not False
    if layout.stamps_azimuths:
        measured = [turn for turn, kept in zip(index.measured_turns_us, ordered.tolist(), strict=True) if kept]
        starts, turns = place_turns(messages_us, "start", find_usual_turns(messages_us, measured.__getitem__))
        turns[-1] = index.turns_us[int(np.flatnonzero(ordered)[-1])] or turns[-1]
        notes += sensing.idle()
    else:
        stamp = sensing.stamp or polar_message.usual_stamp(topic, layout)
        arrivals, smoothed = smooth_arrivals(messages_us)
        starts, turns = place_turns(arrivals, stamp, find_usual_turns(arrivals))
        notes.append(f"{layout.value} of the images taken as azimuths; " + spread_note("header", stamp, clockwise))
        notes += smoothed
    if sensing.range_resolution is None:
        notes.append(f"range resolution {RANGE_RESOLUTION_M} m assumed: --range-resolution overrides it")
    odometry, truth = (bags.trajectory_of(index.poses.get(name or "", ())) for name in (odometry_topic, truth_topic))
    if odometry is not None:
        notes.append(f"odometry from {odometry_topic}, taken as the motion of the radar itself")
    if truth is not None:
        notes.append(f"ground truth from {truth_topic}, taken as the pose of the radar itself")
    return RosbagRecording(
        path=path,
        format="rosbag",
        stamps_us=starts,
        turns_us=turns,
        range_resolution=sensing.range_resolution or RANGE_RESOLUTION_M,
        odometry=odometry,
        ground_truth=truth,
        notes=tuple(notes),
        faults=tuple(faults),
        topic=topic,
        layout=layout,
        messages_us=messages_us,
        logged_ns=np.array(index.logged_ns, dtype=np.int64)[ordered],
        clockwise=clockwise,
    )


@dataclass(slots=True)
class _Index:
    """What one pass over a bag collects: revolutions, messages that are none, and poses (t, x, y, yaw) by topic.

    Turns are those of revolutions whose azimuths are stamped, None where these do not tell; of the messages that are no
    revolutions, the first is kept as an error.
    """

    stamps_us: list[int] = field(default_factory=list)
    logged_ns: list[int] = field(default_factory=list)
    turns_us: list[int | None] = field(default_factory=list)
    measured_turns_us: list[float | None] = field(default_factory=list)
    unread: int = 0
    error: DataError | None = None
    poses: dict[str, list[bags.PoseRow]] = field(default_factory=dict)


def _radar_topic(path: Path, reader: AnyReader) -> tuple[str, Layout, list[str]]:
    """The radar's topic, the layout of its messages, and a note on the choice."""
    filled = [connection for connection in reader.connections if connection.msgcount]
    images = [connection for connection in filled if connection.msgtype in (IMAGE_TYPE, COMPRESSED_TYPE)]
    ranked = [(rank, c) for c in images if (rank := polar_message.topic_rank(c.topic)) is not None]
    named = [c for _, c in sorted(ranked, key=lambda entry: entry[0])]
    named += [connection for connection in filled if connection.msgtype == B_SCAN_TYPE]
    if named:
        chosen, note = named[0], f"radar from {named[0].topic}"
    else:
        alike = {c.topic: c for c in images if polar_message.looks_like_radar(_first(reader, c))}
        if len(alike) != 1:
            raise DataError(
                path,
                f"has {'several topics that could be' if alike else 'no'} radar (topics: {bags.topics_there(reader)})",
                f"radar is {IMAGE_TYPE} or CompressedImage on /Navtech/Polar or /radar/polar, or {B_SCAN_TYPE}",
            )
        chosen = next(iter(alike.values()))
        note = f"radar from {chosen.topic}, the only topic with images shaped like a radar's"
    return chosen.topic, _layout(path, reader, chosen), [note]


def _layout(path: Path, reader: AnyReader, connection: Connection) -> Layout:
    """The layout of a radar's messages, seen from the first that is a revolution."""
    first: DataError | None = None
    for _, logged, raw in itertools.islice(reader.messages([connection]), _FIRST_TRIED):
        try:
            with bags.naming(path, connection.topic, logged):
                message = bags.deserialised(reader, connection, raw)
                return polar_message.layout_of(connection.topic, connection.msgtype, message)
        except DataError as error:
            first = first or error
    raise first or DataError(path, f"holds no message on {connection.topic}", "name another bag")


def _first(reader: AnyReader, connection: Connection) -> Any:
    """The first message of a connection."""
    _, _, raw = next(reader.messages([connection]))
    return reader.deserialize(raw, connection.msgtype)


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
    connections = [c for c in reader.connections if c.topic == topic or c.topic in pose_topics]
    for connection, logged, raw in reader.messages(connections):
        if connection.topic != topic:
            message: Any = reader.deserialize(raw, connection.msgtype)
            index.poses.setdefault(connection.topic, []).append(bags.pose_row(connection.msgtype, message))
            continue
        try:
            with bags.naming(path, topic, logged):
                message = bags.deserialised(reader, connection, raw)
                stamp = _stamp_us(layout, message, logged)
        except DataError as error:
            index.unread += 1
            index.error = index.error or error.with_traceback(None)
            continue
        index.stamps_us.append(stamp)
        index.logged_ns.append(logged)
        if layout.stamps_azimuths:
            azimuths = polar_message.stamped_azimuths(layout, message)
            index.turns_us.append(azimuths.turn_us)
            index.measured_turns_us.append(azimuths.measured_turn_us)
    if 2 * index.unread > index.unread + len(index.stamps_us) and index.error is not None:
        raise index.error
    return index


def _stamp_us(layout: Layout, message: Any, logged_ns: int) -> int:
    """Stamp [us] of a message: its first azimuth's, else the header's, else when it was recorded."""
    if layout.stamps_azimuths:
        return int(polar_message.stamped_azimuths(layout, message).stamps_us[0])
    if message.__msgtype__ != COMPRESSED_TYPE:  # to decode every image of a bag only to index it takes minutes
        polar_message.pixels(message)
    return bags.header_us(message) or logged_ns // 1000
