"""The sensors besides the radar: the user's choice, readings, the radar's mount, and where on the Earth a map lies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of


class _Stamped:
    """Base of the classes that hold stamped readings of a sensor."""

    __slots__ = ()
    stamps_us: NDArray[np.int64]
    source: str

    def __len__(self) -> int:
        return len(self.stamps_us)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.source!r}, {count_of(len(self), 'reading')}>"

    @property
    def rate_hz(self) -> float:
        """Readings per second, from the median time between readings; NaN with fewer than two readings."""
        return float(1e6 / np.median(np.diff(self.stamps_us))) if len(self) > 1 else float("nan")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Gyroscope(_Stamped):
    """Angular rates over time, in the clock and about the axes of the sensor that measured them.

    Args:
        stamps_us: (N,) int64 [us], strictly increasing.
        rates: (N, 3) rad/s about x forward, y left and z up of the gyroscope, as the file's layout states these axes.
        source: the file or topic that the readings come from, for messages.
        own_clock: whether the gyroscope is known to have a clock of its own, so that an offset from the radar's clock is no
            fault.
    """

    stamps_us: NDArray[np.int64]
    rates: NDArray[np.float64]
    source: str
    own_clock: bool = False


_LONGEST: Final = 5.0  # a step between readings that is longer than this many median steps counts as a gap


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """The angle by which a gyroscope has rotated about one axis, interpolated between its readings.

    Args:
        times: (N,) times of the readings [s] since the recording's start, increasing.
        angles: (N,) rotation from the first reading to each reading [rad].
        gaps: (N,) number of gaps before each reading; a gap is a step between readings of more than five median steps.
    """

    times: NDArray[np.float64]
    angles: NDArray[np.float64]
    gaps: NDArray[np.int64]

    @classmethod
    def integrate(cls, gyroscope: Gyroscope, start_us: int, axis: int) -> Turning:
        """Integrates the rates about one of a gyroscope's axes by the trapezoidal rule.

        Args:
            gyroscope: a gyroscope with at least two readings.
            start_us: stamp [us] of the recording's time zero.
            axis: 0 for x, 1 for y, 2 for z.
        """
        times, rates = np.asarray((gyroscope.stamps_us - start_us) * 1e-6, dtype=np.float64), gyroscope.rates[:, axis]
        steps = np.diff(times)
        angles = np.concatenate([[0.0], np.cumsum(0.5 * (rates[1:] + rates[:-1]) * steps)])
        gaps = np.concatenate([[0], np.cumsum(steps > _LONGEST * np.median(steps))])
        return cls(times, angles, gaps)

    def between(self, begins: NDArray[np.float64], ends: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns the rotations (M,) [rad] from `begins` to `ends` (M,) [s]; NaN across gaps and beyond the readings."""
        turned = np.interp(ends, self.times, self.angles) - np.interp(begins, self.times, self.angles)
        last = len(self.times) - 1
        first_after = np.searchsorted(self.times, begins, side="right")
        first_not_before = np.searchsorted(self.times, ends, side="left")
        known = (self.times[0] <= begins) & (ends <= self.times[-1])
        known &= self.gaps[np.clip(first_after - 1, 0, last)] == self.gaps[np.clip(first_not_before, 0, last)]
        return np.where(known, turned, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class KnownTurning:
    """The yaw rate of the radar from a calibrated gyroscope.

    Args:
        turning: rotation about the gyroscope's axis that is parallel to the radar's vertical axis.
        scale: yaw of the radar per rotation about this axis; negative if the gyroscope is mounted upside down.
        delay_s: delay of the gyroscope's stamps against the radar's clock [s]; positive if the stamps are late.
        bias: bias of the yaw rate after scaling [rad/s].
    """

    turning: Turning
    scale: float
    delay_s: float
    bias: float

    def mean_rate(self, t0: float, t1: float) -> float:
        """Returns the mean yaw rate [rad/s] between two times [s] since the recording's start; NaN where it is not known."""
        if t1 <= t0:
            return float("nan")
        turned = self.turning.between(np.array([t0 + self.delay_s]), np.array([t1 + self.delay_s]))[0]
        return float(self.scale * turned / (t1 - t0) - self.bias)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Fixes(_Stamped):
    """GNSS fixes over time (WGS 84).

    Args:
        stamps_us: (N,) int64 [us], strictly increasing, in the recording's clock.
        latitudes: (N,) degrees, north is positive.
        longitudes: (N,) degrees, east is positive.
        sigmas_m: (N,) standard deviation of the position along each horizontal axis, as the receiver states it [m]; NaN
            where it states none.
        source: the file or topic that the fixes come from, for messages.
        made_truth: whether the recording's ground truth was made from this receiver, so that the evaluation of an
            estimate that uses the fixes would be meaningless.
        own_clock: whether the receiver is known to have a clock of its own.
    """

    stamps_us: NDArray[np.int64]
    latitudes: NDArray[np.float64]
    longitudes: NDArray[np.float64]
    sigmas_m: NDArray[np.float64]
    source: str
    made_truth: bool = False
    own_clock: bool = False


_DAY_S: Final = 86_400.0
_WEEKS_S: Final = 1024.0 * 7.0 * _DAY_S  # GPS counts weeks from zero again after 1024 of them
_GPS_EPOCH_S: Final = 315_964_800.0  # from 1970 to the beginning of GPS time
_LEAPS_S: Final = (18.0, 17.0, 16.0, 15.0)  # seconds by which GPS time has been ahead of UTC since 2009
_TIMES_OFF: Final = {
    **{seconds: f"{seconds:.0f} s, the difference between GPS time and UTC" for seconds in _LEAPS_S},
    37.0: "37 s, the difference between TAI and UTC",
    **{3600.0 * hours: f"{hours} h, like a time zone" for hours in range(1, 15)},
    _DAY_S: "a day",
    _WEEKS_S: "1024 weeks, after which GPS receivers count from zero again",
    2.0 * _WEEKS_S: "2048 weeks, as GPS receivers count from zero again after 1024",
    _GPS_EPOCH_S: "the time from 1970 to 1980, when GPS time begins",
}
KNOWN_S: Final = tuple(side * seconds for seconds in _TIMES_OFF for side in (1.0, -1.0))
"""All known delays of stamps [s]: the delays of `_TIMES_OFF` with both signs; positive where stamps are late."""


def describe_offset(late_s: float) -> str:
    """Describes one of the delays of `KNOWN_S` [s] in words, such as `late by a day`."""
    return f"{'late' if late_s > 0.0 else 'early'} by {_TIMES_OFF[abs(late_s)]}"


def find_offset(first_us: int, last_us: int, start_us: int, end_us: int) -> float | None:
    """Finds which of the delays in `KNOWN_S` explains why stamps lie outside the time of a recording.

    Args:
        first_us: the first stamp [us].
        last_us: the last stamp [us].
        start_us: start of the recording [us].
        end_us: end of the recording [us].

    Returns:
        The known delay of the stamps [s], negative if they are early, whose removal makes the two spans of time overlap
        most. None if they then overlap by less than half of the shorter span, or if the delay is no longer than the longer
        span, since then the sensor may just have started before or after the recording.
    """

    def share(late_s: float) -> float:
        begin, end = first_us - round(1e6 * late_s), last_us - round(1e6 * late_s)
        return (min(end, end_us) - max(begin, start_us)) / max(1, min(last_us - first_us, end_us - start_us))

    best = max(KNOWN_S, key=lambda late_s: (round(share(late_s), 2), -abs(first_us - 1e6 * late_s - start_us)))
    longest_us = max(last_us - first_us, end_us - start_us)
    return best if share(best) >= 0.5 and 1e6 * abs(best) > longest_us else None


@dataclass(frozen=True, slots=True)
class TangentPlane:
    """A local tangent plane (WGS 84) with axes to the east and north.

    Args:
        latitude, longitude: position of its origin [degrees].
    """

    latitude: float
    longitude: float

    @classmethod
    def at_middle(cls, fixes: Fixes) -> TangentPlane:
        """Returns the plane that touches the Earth at the median latitude and longitude of one or more fixes."""
        return cls(float(np.median(fixes.latitudes)), float(np.median(fixes.longitudes)))

    def project(self, latitudes: NDArray[np.float64], longitudes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Converts positions (N,) [degrees] to points of the plane (N, 2): east, north [m]."""
        from pymap3d import geodetic2enu

        east, north, _ = geodetic2enu(latitudes, longitudes, 0.0, self.latitude, self.longitude, 0.0)
        return np.column_stack([east, north])

    def locate(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Converts points (N, 2) of the plane [m] to positions on the Earth (N, 2): latitude, longitude [degrees]."""
        from pymap3d import enu2geodetic

        latitudes, longitudes, _ = enu2geodetic(*points.T, 0.0, self.latitude, self.longitude, 0.0)
        return np.column_stack([latitudes, longitudes])


@dataclass(frozen=True, slots=True, eq=False)
class Georeference:
    """The pose of a map in a local tangent plane.

    Args:
        plane: the tangent plane.
        pose: (3,) pose of the map's frame in the plane: east [m], north [m], and yaw counter-clockwise from east [rad].
    """

    plane: TangentPlane
    pose: se2.Array

    def carry(self, frame: se2.Array) -> Georeference:
        """Returns the georeference of the map in a new frame, in which the old one has the pose `frame` (3,) [m, m, rad]."""
        return Georeference(self.plane, se2.compose(self.pose, se2.inverse(frame)))

    def locate(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Converts points (N, 2) of the map [m] to positions on the Earth (N, 2): latitude, longitude [degrees]."""
        return self.plane.locate(se2.transform(self.pose, points))


RADAR, VEHICLE = "radar", "vehicle"
"""The names of the two frames of which a run can write the poses: the radar's and the vehicle's."""


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """The planar pose of the radar on the vehicle, x forward, y left (REP 103).

    Args:
        pose: (3,) x [m], y [m] and yaw [rad] of the radar in the vehicle's frame.
        source: the file, topic or publication that states the pose, for messages.
        given: True if the user states the pose, False if the recording or a publication states it.
    """

    pose: se2.Array
    source: str
    given: bool = False

    def carry_to_radar(self, vehicle: Trajectory) -> Trajectory:
        """Converts poses of the vehicle to poses of the radar, in the same fixed frame."""
        return vehicle.attach(self.pose)

    def carry_to_vehicle(self, radar: Trajectory) -> Trajectory:
        """Converts poses of the radar to poses of the vehicle, in the same fixed frame."""
        return radar.attach(se2.inverse(self.pose))


@dataclass(frozen=True, slots=True, eq=False)
class Sensors:
    """The sensors that a run may use besides the radar and odometry; None for a sensor that is missing or not to be used.

    Args:
        gyroscope: readings of a gyroscope.
        fixes: fixes of a GNSS receiver.
        mount: where the radar sits on the vehicle.
    """

    gyroscope: Gyroscope | None = None
    fixes: Fixes | None = None
    mount: Mount | None = None


NO_SENSORS = Sensors()
"""No sensors besides the radar and odometry."""


@dataclass(frozen=True, slots=True)
class Inputs:
    """The user's choice of each input besides the scans. `auto` takes what the recording holds, if it holds any.

    Args:
        odometry: `auto`, `none`, or the path of a file.
        imu: the gyroscope: `auto`, `none`, or the path of a file.
        gnss: the GNSS fixes: `auto` (not fixes from which the ground truth was made), `none`, or the path of a file.
        extrinsics: pose of the radar on the vehicle: `auto`, `none`, or a text X,Y,YAW (metres forward, metres to the left,
            degrees to the left).
        frame: whose poses a run writes: `radar` or `vehicle`.
    """

    odometry: str = "auto"
    imu: str = "auto"
    gnss: str = "auto"
    extrinsics: str = "auto"
    frame: str = RADAR


USUAL_INPUTS = Inputs()
