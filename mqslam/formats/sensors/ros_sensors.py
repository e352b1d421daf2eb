"""Reads and writes sensors in ROS bags: `sensor_msgs/Imu`, `sensor_msgs/NavSatFix`, and mounts on /tf_static or /tf.

If a topic of fixes is named like ground truth (`bags.is_truth`), the recording's ground truth counts as made from the fixes.
"""

from __future__ import annotations

from array import array
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mqslam.core.recording import Recording
from mqslam.core.sensors import Fixes, Gyroscope, Mount
from mqslam.core.wording import count_of
from mqslam.errors import DataError
from mqslam.formats import bags
from mqslam.formats.bags import RADAR_FRAME, TF_TYPE, VEHICLE_FRAME, Bag
from mqslam.formats.sensors.reading import Reading, make_fixes, make_gyroscope
from mqslam.formats.tables import SensorTable
from mqslam.formats.transforms import Mounts

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

IMU_TYPE, FIX_TYPE = "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"
STATIC_TOPIC = "/tf_static"
_IMU_TOPIC, _FIX_TOPIC, _TRUTH_FIX_TOPIC = "/imu/data", "/gps/fix", "/ground_truth/fix"
_IMU_FRAME, _FIX_FRAME = "imu", "gps"  # no transform places these frames, so readers do not rotate the rates
_NOT_GIVEN = -1.0  # first number of the covariance of a quantity that an Imu message does not state
_NO_FIX, _UNKNOWN = -1, -2  # statuses of a NavSatFix; drivers that never set the status leave it unknown


@dataclass(slots=True)
class RosSensors:
    """The messages of a bag's sensors, which `add` collects one by one.

    Args:
        imu_topic: topic of the gyroscope, or None.
        fix_topic: topic of the GNSS receiver, or None.
        others: further topics of gyroscopes and GNSS receivers, which are not read.
        transform_topics: topics of transforms; only transforms that never change are used.
        rows: by topic, four numbers per message: its stamp [us], followed by turn rates about x, y, z [rad/s], or by
            latitude, longitude [degrees] and standard deviation [m], which is NaN if the message does not state it.
        unread: by topic, the number of damaged messages.
        imu_frame: name of the gyroscope's frame; "" until a message names the frame.
        unfixed: number of GNSS messages without a fix.
        unstated: number of GNSS messages that do not state whether they have a fix.
        mounts: the transforms that never change.
        clock: reads the stamps of messages.
    """

    imu_topic: str | None
    fix_topic: str | None
    others: tuple[str, ...]
    transform_topics: tuple[str, ...] = ()
    rows: defaultdict[str, array[float]] = field(default_factory=lambda: defaultdict(lambda: array("d")))
    unread: Counter[str] = field(default_factory=Counter)
    imu_frame: str = ""
    unfixed: int = 0
    unstated: int = 0
    mounts: Mounts = field(default_factory=Mounts)
    clock: bags.Clock = field(default_factory=bags.Clock)

    @classmethod
    def choose(cls, reader: AnyReader) -> RosSensors:
        """Chooses for each sensor the topic with most messages.

        A topic named like ground truth is never chosen for the gyroscope, and for fixes only if they have no other topic.
        """
        imus = [topic for topic in _rank_topics(reader, IMU_TYPE) if not bags.is_truth(topic)]
        receivers = _rank_topics(reader, FIX_TYPE)
        transforms = tuple(dict.fromkeys(c.topic for c in reader.connections if Mounts.reads(c)))
        return cls(next(iter(imus), None), next(iter(receivers), None), (*imus[1:], *receivers[1:]), transforms)

    def reads(self, topic: str) -> bool:
        """Returns whether `add` takes the messages of a topic."""
        return topic in (self.imu_topic, self.fix_topic, *self.transform_topics)

    def add(self, reader: AnyReader, connection: Connection, logged_ns: int, raw: bytes) -> None:
        """Adds a message, recorded at a time [ns], of a topic that `reads` accepts; a damaged message is only counted."""
        try:
            topic, message = connection.topic, bags.deserialise(reader, connection, raw)
            if topic in self.transform_topics:
                self.mounts.add(message, topic)
                return
            add_row = self._add_rates if topic == self.imu_topic else self._add_place
            add_row(topic, message, self.clock.stamp(topic, message, logged_ns))
        except (ValueError, OverflowError, AttributeError):
            self.unread[connection.topic] += 1

    def read_gyroscope(self, path: Path) -> Reading[Gyroscope] | None:
        """Returns the gyroscope, in the vehicle's axes if transforms lead to the vehicle; None if the bag has no gyroscope.

        Raises:
            DataError: fewer than two messages can be used.
        """
        if self.imu_topic is None:
            return None
        table = self._to_table(self.imu_topic)
        placed = self.mounts.place(self.imu_frame)
        if placed is None:
            note = f"the axes of the gyroscope on {self.imu_topic} are taken as x forward, y left, z up"
        else:
            note = (
                f"the gyroscope on {self.imu_topic} is rotated to the vehicle's axes by its frame's pose ({self.imu_frame})"
            )
            with np.errstate(invalid="ignore"):  # rates that are not finite are left out afterwards
                table = table.with_columns(table.columns @ placed[:3, :3].T)
        return make_gyroscope(path, table, note, source=self.imu_topic)

    def read_fixes(self, path: Path) -> Reading[Fixes] | None:
        """Returns the GNSS fixes; None if the bag has no topic of fixes, or no message states a fix.

        Raises:
            DataError: no message can be used.
        """
        if self.fix_topic is None or ((self.unfixed or self.unstated) and not self.rows[self.fix_topic]):
            return None
        table = self._to_table(self.fix_topic)
        return make_fixes(path, table, source=self.fix_topic, made_truth=bags.is_truth(self.fix_topic))

    def read_mount(self, path: Path, radar_frame: str) -> Mount | None:
        """Returns the radar's pose on the vehicle, as the transforms state it; None if no transforms connect the frames.

        Raises:
            DataError: no transforms connect the frames, but messages on /tf_static are damaged; or the transforms have
                numbers that are not finite.
        """
        topic = self.mounts.find_topic(radar_frame)
        pose = self.mounts.find(radar_frame) if topic else None
        if pose is None:
            if damaged := self.unread[STATIC_TOPIC]:
                raise DataError(path, f"holds {count_of(damaged, 'damaged message')} on {STATIC_TOPIC}", "repair the bag")
            return None
        if not np.isfinite(pose).all():
            raise DataError(path, f"places {radar_frame} by transforms that are not finite", f"repair {topic}")
        return Mount(pose, topic)

    @property
    def notes(self) -> list[str]:
        """Notes for the user on the chosen topics, the messages without a fix, and the stamps."""
        notes = [f"gyroscope from {self.imu_topic}"] if self.imu_topic else []
        notes += [f"GNSS fixes from {self.fix_topic}"] if self.fix_topic else []
        notes += [f"other sensors of these kinds are not read: {', '.join(self.others)}"] if self.others else []
        if self.unfixed:
            notes.append(f"the receiver states no fix in {count_of(self.unfixed, 'message')} on {self.fix_topic}: left out")
        if self.unstated:
            said = "whose status is not set (-2): those with a position are taken as fixes"
            notes.append(f"{count_of(self.unstated, 'message')} on {self.fix_topic} {said}")
        return notes + self.clock.notes

    def _to_table(self, topic: str) -> SensorTable:
        """Returns the stamps and the three values of the messages on a topic."""
        rows = np.array(self.rows[topic]).reshape(-1, 4)
        return SensorTable(rows[:, 0].astype(np.int64), rows[:, 1:], self.unread[topic])

    def _add_rates(self, topic: str, message: Any, stamp_us: int) -> None:
        """Adds the turn rates of an Imu message; raises ValueError if the message states no rates."""
        if message.angular_velocity_covariance[0] == _NOT_GIVEN:
            raise ValueError("states no rates")
        rate = message.angular_velocity
        self.rows[topic].extend([stamp_us, rate.x, rate.y, rate.z])
        self.imu_frame = message.header.frame_id

    def _add_place(self, topic: str, message: Any, stamp_us: int) -> None:
        """Adds the position in a NavSatFix message with its standard deviation, or counts the message if it has no fix."""
        is_unknown = message.status.status == _UNKNOWN
        self.unstated += is_unknown
        if message.status.status <= _NO_FIX and not (is_unknown and _is_place(message.latitude, message.longitude)):
            self.unfixed += not is_unknown
            return
        known = message.position_covariance_type != 0
        variance = float(message.position_covariance[0] + message.position_covariance[4]) / 2.0 if known else np.nan
        sigma = float(np.sqrt(variance)) if variance > 0.0 else np.nan
        self.rows[topic].extend([stamp_us, message.latitude, message.longitude, sigma])


def _is_place(latitude: float, longitude: float) -> bool:
    """Returns whether a latitude and a longitude [degrees] are a position, and not the zeros or NaN of a missing fix."""
    return bool(np.isfinite([latitude, longitude]).all()) and (latitude, longitude) != (0.0, 0.0)


def _rank_topics(reader: AnyReader, kind: str) -> list[str]:
    """Lists the topics of a type of message by falling number of messages; topics of ground truth come last."""
    filled = [c for c in reader.connections if c.msgtype == kind and c.msgcount]
    filled.sort(key=lambda c: (bags.is_truth(c.topic), -c.msgcount, c.topic))
    return list(dict.fromkeys(c.topic for c in filled))


def list_sensor_messages(bag: Bag, recording: Recording) -> list[Iterator[tuple[int, Connection, Any]]]:
    """Returns iterators over (stamp [us], connection, message), by stamp: one each for the mount, gyroscope and fixes."""
    lists = []
    if recording.mount is not None:
        lists.append(_list_mount(bag, recording.mount, recording.start_us))
    if recording.gyroscope is not None:
        lists.append(_list_rates(bag, recording.gyroscope))
    if recording.fixes is not None:
        lists.append(_list_fixes(bag, recording.fixes))
    return lists


def _list_mount(bag: Bag, mount: Mount, stamp_us: int) -> Iterator[tuple[int, Connection, Any]]:
    """Yields a single message with a stamp [us]: the transform that states the radar's pose in the vehicle's frame."""
    connection = bag.topic(STATIC_TOPIC, TF_TYPE, latched=True)
    yield stamp_us, connection, bag.transform(stamp_us, (VEHICLE_FRAME, RADAR_FRAME), mount.pose)


def _list_rates(bag: Bag, gyroscope: Gyroscope) -> Iterator[tuple[int, Connection, Any]]:
    """Yields the readings of a gyroscope as Imu messages that mark orientation and acceleration as not given."""
    connection = bag.topic(_IMU_TOPIC, IMU_TYPE)
    level = bag.quaternion(0.0)
    absent, unknown = np.zeros(9), np.zeros(9)
    absent[0] = _NOT_GIVEN
    for stamp, rate in zip(gyroscope.stamps_us.tolist(), gyroscope.rates.tolist(), strict=True):
        header, still = bag.header(stamp, _IMU_FRAME), bag.vector(0.0, 0.0, 0.0)
        yield stamp, connection, bag.make(IMU_TYPE, header, level, absent, bag.vector(*rate), unknown, still, absent)


def _list_fixes(bag: Bag, fixes: Fixes) -> Iterator[tuple[int, Connection, Any]]:
    """Yields GNSS fixes as messages; the heights are written as unknown."""
    connection = bag.topic(_TRUTH_FIX_TOPIC if fixes.made_truth else _FIX_TOPIC, FIX_TYPE)
    status = bag.make("sensor_msgs/msg/NavSatStatus", 0, 1)
    places = zip(fixes.latitudes.tolist(), fixes.longitudes.tolist(), fixes.sigmas_m.tolist(), strict=True)
    for stamp, (latitude, longitude, sigma) in zip(fixes.stamps_us.tolist(), places, strict=True):
        known = not np.isnan(sigma)
        covariance = np.diag([sigma**2, sigma**2, 0.0]).ravel() if known else np.zeros(9)
        header = bag.header(stamp, _FIX_FRAME)
        yield stamp, connection, bag.make(FIX_TYPE, header, status, latitude, longitude, np.nan, covariance, int(known))
