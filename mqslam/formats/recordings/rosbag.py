"""Reads and writes recordings in ROS bags: ROS 1 `.bag`, ROS 2 bag folder or `.db3`, `.mcap`.

A bag holds the messages of the radar, odometry, ground truth and the other sensors. Bags are written with the radar on
/Navtech/Polar or /radar_data/b_scan_msg, odometry on /odom, ground truth on /ground_truth and the other sensors on the
topics of `mqslam.formats.sensors.ros_sensors`.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.recording import PolarScan, Recording
from mqslam.core.sensors import Mount
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of, is_or_are
from mqslam.errors import DataError, OfLidarError, Remedy, untrusted
from mqslam.formats import bags
from mqslam.formats.bags import KINDS, ODOMETRY_TYPE, RADAR_FRAME, VEHICLE_FRAME, Bag, name_frame, write_bag
from mqslam.formats.lidars import laserscan
from mqslam.formats.recordings import radar_messages
from mqslam.formats.recordings.arrivals import estimate_arrivals
from mqslam.formats.recordings.azimuths import azimuth_stamps, check_encoder, note_spread, spread_azimuths
from mqslam.formats.recordings.derived import mirror
from mqslam.formats.recordings.layout import Message, Sensing, Target, Topics, note_resolution
from mqslam.formats.recordings.radar_messages import RadarTopic, StatedRanges, open_message, read_turns
from mqslam.formats.recordings.turns import find_usual_turns, place_turns
from mqslam.formats.sensors.reading import add_beside, read_beside
from mqslam.formats.sensors.ros_sensors import RosSensors, list_sensor_messages
from mqslam.formats.stamps import mark_increasing
from mqslam.formats.transforms import Mounts

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

RANGE_RESOLUTION_M = 0.0438  # as in Oxford's recordings; assumed where a bag does not state it
ODOMETRY_TOPIC = "/odom"
TRUTH_TOPIC = "/ground_truth"
_TOPICS = {"image": ("/Navtech/Polar", bags.IMAGE_TYPE), "b_scan": ("/radar_data/b_scan_msg", bags.B_SCAN_TYPE)}
_Entry = tuple[int, "Connection", Any]  # stamp [us], connection of the topic, message


@dataclass(frozen=True, kw_only=True)
class RosbagRecording(Recording):
    """A recording in a ROS bag; the bag is opened again by every call of `polar_scans`.

    Args:
        radar: the radar's topic.
        messages_us: (N,) int64 [us], stamp of the message of each polar scan, as `RadarTopic.read_stamp` returns it.
        logged_ns: (N,) int64 [ns], time at which the message of each polar scan was recorded.
        clockwise: whether azimuths follow one another clockwise, seen from above, if messages do not state their angles.
    """

    radar: RadarTopic
    messages_us: NDArray[np.int64]
    logged_ns: NDArray[np.int64]
    clockwise: bool

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Reads the polar scans start <= k < stop."""
        wanted = range(len(self))[start:stop]
        if not wanted:
            return
        k, topic = wanted.start, self.radar.name
        with untrusted.blame_file(self.path), bags.open_bag(self.path) as reader:
            connections = [connection for connection in reader.connections if connection.topic == topic]
            first, after = int(self.logged_ns[k]), self._until(connections, wanted.stop)
            for connection, logged, raw in read_turns(reader, reader.messages(connections, first, after), topic):
                try:
                    message = open_message(reader, connection, raw)
                    if self.radar.read_stamp(message, logged, bags.Clock()) != self.messages_us[k]:
                        continue
                except ValueError:  # the index left this message out, too
                    continue
                with bags.name_message(self.path, topic, logged):
                    polar_scan = self._polar_scan(k, message)
                yield polar_scan
                k += 1
                if k == wanted.stop:
                    return
        raise DataError(self.path, f"polar scan {k} on {topic} is gone: the bag has changed", "open the bag again")

    def _until(self, connections: list[Connection], stop: int) -> int | None:
        """Returns the time [ns] before which the polar scans k < stop were recorded; None for the end of the bag."""
        if not any(connection.msgtype.endswith(bags.FFT_NAMES) for connection in connections):
            return int(self.logged_ns[stop - 1]) + 1
        return int(self.logged_ns[stop]) if stop < len(self) else None

    def _polar_scan(self, k: int, message: Any) -> PolarScan:
        """Makes polar scan k from its message, or from the b-scan that `read_turns` gathered."""
        power = self.radar.read_power(message)
        if self.radar.stamps_azimuths:
            azimuths = self.radar.read_azimuths(message)
        else:
            begin, duration = int(self.stamps_us[k]), int(self.turns_us[k])
            azimuths = spread_azimuths(len(power), begin, duration, clockwise=self.clockwise)
        return azimuths.to_polar_scan(power, self.start_us)


recognises = bags.recognises


def open_recording(path: Path, sensing: Sensing) -> Recording:
    """Indexes a bag in one pass over its messages; only stamps, poses and readings of other sensors stay in memory.

    Raises:
        OfLidarError: the bag holds scans of a lidar and no topic of a radar.
        DataError: no topic is known to be the radar's, or more than half of the radar's messages cannot be read.
    """
    with bags.open_bag(path) as reader:
        if sensing.topics.radar is None and laserscan.holds_scans(reader):
            raise OfLidarError(path)
        encoder = sensing.encoder_size or radar_messages.read_encoder_size(reader)
        radar, notes = radar_messages.choose_topic(path, reader, sensing.topics.radar, encoder)
        odometry_topic, truth_topic = _choose_pose_topics(path, reader, sensing.topics)
        sensors, stated = RosSensors.choose(reader), radar_messages.read_ranges(reader)
        index = _read_index(path, reader, radar, {odometry_topic, truth_topic} - {None}, sensors)
    ordered = np.ones(len(index.stamps_us), dtype=np.bool_)
    if radar.stamps_azimuths:  # else polar scans are in the order of their messages
        ordered = mark_increasing(index.stamps_us)
    messages_us = np.array(index.stamps_us, dtype=np.int64)[ordered]
    faults = []
    if index.unread:
        left_out = f"could not be read and {is_or_are(index.unread)} left out: {index.error}"
        faults.append(f"{count_of(index.unread, 'message')} on {radar.name} {left_out}")
    if skipped := len(ordered) - len(messages_us):
        faults.append(f"the stamps of {count_of(skipped, 'message')} on {radar.name} repeat or run backward: left out")
    upside_down = sensors.mounts.is_upside_down(index.radar_frame)
    clockwise, stamp_sigma_s = (not upside_down if sensing.clockwise is None else sensing.clockwise), 0.0
    if radar.stamps_azimuths:
        measured = [turn for turn, kept in zip(index.measured_turns_us, ordered.tolist(), strict=True) if kept]
        if encoder is None:
            faults += check_encoder(path, messages_us, [measured[0], measured[-1]], index.turn_ticks)
        starts, turns = place_turns(messages_us, "start", find_usual_turns(messages_us, measured.__getitem__))
        turns[-1] = index.turns_us[int(np.flatnonzero(ordered)[-1])] or turns[-1]
        notes += sensing.note_unused()
    else:
        stamp, arrivals = sensing.stamp or radar.usual_stamp, estimate_arrivals(messages_us)
        starts, turns = place_turns(arrivals.stamps_us, stamp, find_usual_turns(arrivals.stamps_us))
        stamp_sigma_s = arrivals.sigma_s
        notes.append(f"{radar.layout.value} of the images are taken as azimuths; " + note_spread("header", stamp, clockwise))
        notes += arrivals.notes
        faults += arrivals.faults
    resolution, offset, ranged = _choose_ranges(sensing, stated)
    notes += ranged
    odometry, truth = (index.poses.trajectory(name) for name in (odometry_topic, truth_topic))
    for name in (odometry_topic, truth_topic):
        faults += index.poses.note_left_out(name)
    notes += index.poses.clock.notes
    mount, unplaced = read_beside(lambda: sensors.read_mount(path, index.radar_frame))
    frames, truth_on_vehicle = Frames(index.radar_frame, mount, sensors.mounts), False
    if odometry is not None and odometry_topic is not None:
        odometry, note = frames.place_odometry(odometry, odometry_topic, index.poses.frames[odometry_topic])
        notes.append(note)
    if truth is not None and truth_topic is not None:
        truth, note, truth_on_vehicle = frames.place_truth(truth, truth_topic, index.poses.frames[truth_topic])
        notes.append(note)
    recording = RosbagRecording(
        path=path,
        format="rosbag",
        stamps_us=starts,
        turns_us=turns,
        range_resolution=resolution,
        range_offset=offset,
        is_resolution_assumed=sensing.range_resolution is None and stated is None,
        stamp_sigma_s=stamp_sigma_s,
        odometry=odometry,
        ground_truth=truth,
        truth_on_vehicle=truth_on_vehicle,
        notes=(*notes, *sensors.notes),
        faults=(*faults, *unplaced),
        radar=radar,
        messages_us=messages_us,
        logged_ns=np.array(index.logged_ns, dtype=np.int64)[ordered],
        clockwise=clockwise,
    )
    placed = add_beside(recording, lambda: sensors.read_gyroscope(path), lambda: sensors.read_fixes(path), lambda: mount)
    if not upside_down:
        return placed
    over = f"{sensors.mounts.find_topic(index.radar_frame)} places the radar upside down"
    if sensing.clockwise is not None:
        return replace(placed, notes=(*placed.notes, f"{over}, which is ignored because sensor.clockwise is set"))
    if radar.stamps_azimuths:
        return mirror(placed, f"{over}: the scans are mirrored")
    return replace(placed, notes=(*placed.notes, f"{over}: the radar turns counter-clockwise, seen from above"))


@dataclass(frozen=True, slots=True)
class Frames:
    """The frames of a bag, which show whether a topic holds poses of the radar, of the vehicle or of another frame.

    In the methods, `frame` is the name of the frame whose poses a topic holds, "" if the messages do not name it.

    Args:
        radar: name of the frame of the radar's messages.
        mount: the radar's pose on the vehicle; None if the bag does not state it.
        placed: the transforms of the bag that never change.
    """

    radar: str
    mount: Mount | None
    placed: Mounts

    def place_odometry(self, odometry: Trajectory, topic: str, frame: str) -> tuple[Trajectory, str]:
        """Returns odometry as poses of the vehicle if the mount is known, else as poses of the radar, and a note on this.

        If the mount is known, odometry without a frame, or with a frame that no transform places, is taken as the motion of
        the vehicle, since it usually comes from the vehicle's wheels.
        """
        if self.mount is None:
            return odometry, f"odometry from {topic} is taken as the motion of the radar itself"
        on_vehicle = self._find(frame)
        if on_vehicle is None:
            return odometry, f"odometry from {topic} is taken as the motion of the vehicle, on which {self.radar} sits"
        return odometry.attach(se2.inverse(on_vehicle)), f"odometry from {topic} is the motion of {frame}"

    def place_truth(self, truth: Trajectory, topic: str, frame: str) -> tuple[Trajectory, str, bool]:
        """Converts ground truth to poses of the radar if transforms connect the radar and the frame of the ground truth.

        Otherwise the poses stay as they are. If no transform places their frame, they are taken as poses of the radar. If
        only the mount is not known, they are poses of their frame.

        Returns:
            (1) The ground truth, (2) a note on the frame of its poses, (3) whether these are poses of the vehicle's frame.
        """
        if frame and name_frame(frame) == name_frame(self.radar):
            return truth, f"ground truth from {topic} is the pose of the radar", False
        on_vehicle = self._find(frame)
        if on_vehicle is None:
            return truth, f"ground truth from {topic} is taken as the pose of the radar itself", False
        if self.mount is None:
            note = f"ground truth from {topic} is the pose of {frame}; the bag does not state the radar's pose on it"
            return truth, note, not on_vehicle.any()
        to_radar = se2.compose(se2.inverse(on_vehicle), self.mount.pose)
        note = f"ground truth from {topic} is the pose of {frame}, converted to poses of the radar by {self.mount.source}"
        return truth.attach(to_radar), note, False

    def _find(self, frame: str) -> se2.Array | None:
        """Returns the pose (3,) x, y [m], yaw [rad] of a frame on the vehicle; None if no finite transforms state it."""
        pose = self.placed.find(frame) if frame else None
        return pose if pose is not None and np.isfinite(pose).all() else None


@dataclass(slots=True)
class _Index:
    """The result of one pass over the N readable messages of the radar and the messages of other topics.

    Args:
        stamps_us: N stamps [us].
        logged_ns: N times of recording [ns].
        turns_us: if azimuths carry stamps, the N durations of `Azimuths.find_duration` [us] or None; else empty.
        measured_turns_us: if azimuths carry stamps, the N durations of `Azimuths.measure_turn` [us] or None; else empty.
        unread: number of unreadable messages of the radar.
        error: error of the first unreadable message; None if all are readable.
        poses: the poses on the topics of odometry and ground truth.
        radar_frame: first frame that the radar's messages name; "" if there is none.
        turn_ticks: encoder ticks per turn that are assumed if the bag and the user state none.
    """

    stamps_us: list[int] = field(default_factory=list)
    logged_ns: list[int] = field(default_factory=list)
    turns_us: list[int | None] = field(default_factory=list)
    measured_turns_us: list[float | None] = field(default_factory=list)
    unread: int = 0
    error: DataError | None = None
    poses: bags.PoseLog = field(default_factory=bags.PoseLog)
    radar_frame: str = ""
    turn_ticks: int = 0


def _choose_ranges(sensing: Sensing, stated: StatedRanges | None) -> tuple[float, float, list[str]]:
    """Returns the length of a range bin [m], the range offset [m] from a bin's centre, and notes for the user on both.

    The offset is 0 if the bag states none. It is also 0 if the user states one: `recordings.open_radar` applies the user's.
    """
    notes, resolution, offset = [], sensing.range_resolution, 0.0
    if resolution is None and stated is not None:
        resolution = stated.bin_length
        notes.append(f"range resolution {resolution:.6g} m, as {stated.topic} states it")
    elif resolution is None:
        resolution = RANGE_RESOLUTION_M
        notes.append(note_resolution(resolution))
    elif stated is not None:
        notes += sensing.note_contradiction(stated.bin_length, stated.topic)
    if sensing.range_offset is None and stated is not None and stated.middle_of_bin_0 is not None:
        offset = stated.middle_of_bin_0 - 0.5 * resolution
        note = f"a range offset of {offset:.4g} m, as {stated.topic} states it by the range of the middle of bin 0"
        notes.append(f"{note}: {Remedy.OVERRIDE_RANGE_OFFSET}")
    return resolution, offset, notes


def _choose_pose_topics(path: Path, reader: AnyReader, named: Topics) -> tuple[str | None, str | None]:
    """Chooses the topics of odometry and of ground truth: by the user, else by type and name; None if there is none.

    Of several, the first is chosen; for odometry, the first whose name contains `odom`. Raises a DataError if a topic that
    the user names holds no poses.
    """
    typed = [c for c in reader.connections if c.msgtype in (ODOMETRY_TYPE, bags.POSE_TYPE)]
    chosen = (named.odometry, named.truth)
    for topic in chosen:
        if topic is not None:
            bags.require_topic(path, topic, typed, "poses", "poses")
    truths = [c.topic for c in typed if bags.is_truth(c.topic) and c.topic not in chosen]
    drives = [c.topic for c in typed if c.msgtype == ODOMETRY_TYPE and c.topic not in (*truths, *chosen)]
    drives.sort(key=lambda topic: "odom" not in topic.lower())
    return named.odometry or next(iter(drives), None), named.truth or next(iter(truths), None)


def _read_index(
    path: Path, reader: AnyReader, radar: RadarTopic, pose_topics: set[str | None], sensors: RosSensors
) -> _Index:
    """Reads the messages of the radar and of poses in one pass, and adds the messages of other sensors to `sensors`.

    Raises the error of the radar's first unreadable message if more than half of the radar's messages cannot be read.
    """
    index = _Index()
    read = [c for c in reader.connections if c.topic == radar.name or c.topic in pose_topics or sensors.reads(c.topic)]
    for connection, logged, raw in read_turns(reader, reader.messages(read), radar.name):
        if sensors.reads(connection.topic):
            sensors.add(reader, connection, logged, raw)
            continue
        if connection.topic != radar.name:
            index.poses.add(reader, connection, logged, raw)
            continue
        try:
            with bags.name_message(path, radar.name, logged):
                message = open_message(reader, connection, raw)
                stamp = radar.read_stamp(message, logged, index.poses.clock)
        except DataError as error:
            index.unread += 1
            index.error = index.error or error.with_traceback(None)
            continue
        index.stamps_us.append(stamp)
        index.logged_ns.append(logged)
        index.radar_frame = index.radar_frame or radar_messages.read_frame(message)
        if radar.stamps_azimuths:
            index.turn_ticks = max(index.turn_ticks, radar.find_turn(message))
            azimuths = radar.read_azimuths(message)
            index.turns_us.append(azimuths.find_duration())
            index.measured_turns_us.append(azimuths.measure_turn())
    if index.error is not None and index.unread > len(index.stamps_us):
        raise index.error
    return index


def write(kind: str, message: Message, out: Path, recording: Recording) -> list[str]:
    """Writes a recording as a bag, as `Target.write` describes it.

    Args:
        kind: one of `mqslam.formats.bags.KINDS`.
        message: `image` for mono8 images whose rows begin with time, angle and validity, as in the Oxford layout; `b_scan`
            for messages of Navtech's driver, which do not state whether an azimuth was measured.
        out: the file or folder.
        recording: the recording.
    """
    with write_bag(out, kind) as bag:
        sources = [_list_scans(bag, recording, message)]
        if recording.odometry is not None:
            moved = RADAR_FRAME if recording.mount is None else VEHICLE_FRAME
            sources.append(_list_poses(bag, recording.odometry, ODOMETRY_TOPIC, ("odom", moved)))
        if recording.ground_truth is not None:
            placed = VEHICLE_FRAME if recording.truth_on_vehicle else RADAR_FRAME
            sources.append(_list_poses(bag, recording.ground_truth, TRUTH_TOPIC, ("map", placed)))
        sources += list_sensor_messages(bag, recording)
        for stamp, connection, content in heapq.merge(*sources, key=lambda entry: entry[0]):
            bag.write(connection, stamp, content)
    return []


def _list_scans(bag: Bag, recording: Recording, message: Message) -> Iterator[_Entry]:
    """Yields the polar scans as messages, stamped by their first azimuths."""
    make: Callable[..., Any] = radar_messages.make_image if message == "image" else radar_messages.make_b_scan
    connection = bag.topic(*_TOPICS[message])
    for k, polar_scan in enumerate(recording.polar_scans()):
        yield int(azimuth_stamps(recording, polar_scan)[0]), connection, make(bag, recording, k, polar_scan)


def _list_poses(bag: Bag, track: Trajectory, topic: str, frames: tuple[str, str]) -> Iterator[_Entry]:
    """Yields poses as odometry messages; the twist of a message is the mean twist from its pose to the next pose.

    The last message repeats the twist of the message before. `frames` are the names of the fixed and of the moving frame.
    """
    fixed, moved = frames
    connection = bag.topic(topic, ODOMETRY_TYPE)
    twists = track.mean_twists(track.stamps_us[:-1], track.stamps_us[1:])
    unknown = np.zeros(36)
    for stamp, pose, (vx, vy, omega) in zip(
        track.stamps_us.tolist(), track.poses, np.vstack([twists, twists[-1:]]).tolist(), strict=True
    ):
        twist = bag.make("geometry_msgs/msg/Twist", bag.vector(vx, vy, 0.0), bag.vector(0.0, 0.0, omega))
        message = bag.make(
            ODOMETRY_TYPE,
            bag.header(stamp, fixed),
            moved,
            bag.make("geometry_msgs/msg/PoseWithCovariance", bag.pose(pose), unknown),
            bag.make("geometry_msgs/msg/TwistWithCovariance", twist, unknown),
        )
        yield stamp, connection, message


TARGETS = tuple(
    Target(
        kind,
        partial(write, kind, message),
        suffix,
        odometry=True,
        sensors=True,
        validity=message == "image",
        assumed_resolution=lambda _: RANGE_RESOLUTION_M,
        message=message,
        is_bag=True,
    )
    for kind, suffix in KINDS.items()
    for message in get_args(Message)
)
