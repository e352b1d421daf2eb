"""Recordings of a radar, which are indexed and read one polar scan at a time, and recordings of a planar lidar."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.core.sensors import Fixes, Gyroscope, Mount
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of, name_sensor
from mqslam.errors import ConfigError, OfLidarError

FASTEST_TURN_US = 50_000
SLOWEST_TURN_US = 5_000_000
"""Shortest and longest plausible revolution [us]: a radar revolves at most 20 times a second, and at least once in 5 s."""


@dataclass(frozen=True, slots=True)
class PolarScan:
    """The power that the radar receives during one revolution.

    Args:
        times: (A,) [s] since the recording's start, one per azimuth, not decreasing.
        azimuths: (A,) [rad] counter-clockwise from straight ahead (REP 103), unwrapped along the revolution.
        power: (A, B) uint8 received power, one row per azimuth; bin b is centred at (b + 0.5) range resolutions.
        valid: (A,) bool, False where the recording marks the azimuth as not measured.
        down: the azimuths of the same revolution whose chirps go down; the chirps of the azimuths in the other fields then
            go up. The Doppler shift of `down` has the opposite sign. None where all chirps go the same way.
    """

    times: NDArray[np.float64]
    azimuths: NDArray[np.float64]
    power: NDArray[np.uint8]
    valid: NDArray[np.bool_]
    down: PolarScan | None = None

    def __repr__(self) -> str:
        return f"<PolarScan, {count_of(len(self.power), 'azimuth')} of {count_of(self.power.shape[1], 'bin')}>"

    def split(self, rising: NDArray[np.bool_]) -> PolarScan:
        """Returns the azimuths that a mask (A,) marks as having a chirp that goes up, with all others as `down`."""
        return replace(self._take(rising), down=self._take(~rising))

    def _take(self, chosen: NDArray[np.bool_]) -> PolarScan:
        """Returns the azimuths that a mask (A,) chooses."""
        return PolarScan(self.times[chosen], self.azimuths[chosen], self.power[chosen], self.valid[chosen])


@dataclass(frozen=True, eq=False)
class Recording(ABC):
    """A radar recording whose polar scans are read only when needed, so that it can be pickled and sent to workers.

    Two recordings are equal only if they are the same object.

    Args:
        path: the recording.
        format: name of its layout.
        stamps_us: (N,) int64 [us], stamp of the first azimuth of every polar scan, strictly increasing.
        turns_us: (N,) int64 [us], duration of each revolution, without the gap that may follow it.
        range_resolution: length of a range bin [m].
        range_offset: true range of an object at rest minus the range of the bin's centre [m].
        is_resolution_assumed: True if the recording does not state the length of its range bins, so that the layout's usual
            length is used.
        stamp_sigma_s: standard deviation of a polar scan's stamp [s] where stamps are arrival times corrected for their
            delays; 0 where stamps are exact.
        odometry: dead-reckoned poses that the recording contains, or None. They are poses of the vehicle's frame if the
            recording has a mount, and are taken as poses of the radar otherwise.
        ground_truth: poses of the radar that are known better than any estimate, for evaluation only, or None.
        truth_on_vehicle: whether the ground truth is made of poses of the vehicle's frame instead, because the recording
            does not state where the radar sits on the vehicle.
        gyroscope: readings of a gyroscope that the recording contains, or None.
        fixes: GNSS fixes that the recording contains, or None.
        mount: where the radar sits on the vehicle, as the recording states it, or None.
        notes: sentences for the user on how the recording was read.
        faults: defects of the recording; each states the data that were left out or corrected because of it.
    """

    path: Path
    format: str
    stamps_us: NDArray[np.int64]
    turns_us: NDArray[np.int64]
    range_resolution: float
    range_offset: float = field(default=0.0, kw_only=True)
    is_resolution_assumed: bool = field(default=False, kw_only=True)
    stamp_sigma_s: float = field(default=0.0, kw_only=True)
    odometry: Trajectory | None = None
    ground_truth: Trajectory | None = None
    truth_on_vehicle: bool = False
    gyroscope: Gyroscope | None = None
    fixes: Fixes | None = None
    mount: Mount | None = None
    notes: tuple[str, ...] = field(default=())
    faults: tuple[str, ...] = field(default=())

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        if "__repr__" not in vars(cls):
            cls.__repr__ = Recording.__repr__  # type: ignore[method-assign]  # else @dataclass would list all arrays
        if "__eq__" not in vars(cls):  # else @dataclass would compare all arrays, which have no single truth value
            cls.__eq__, cls.__hash__ = object.__eq__, object.__hash__  # type: ignore[method-assign]

    def __len__(self) -> int:
        return len(self.stamps_us)

    def __repr__(self) -> str:
        length = f"{count_of(len(self), 'scan')}, {self.duration_s:.1f} s" if len(self) else "no scans"
        return f"<{type(self).__name__} {str(self.path)!r}, {self.format}, {length}>"

    @abstractmethod
    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Yields the polar scans start <= k < stop, or up to the last if `stop` is None; only one is in memory at a time.

        Raises:
            DataError: a polar scan cannot be read; the error names its file.
        """

    def __getitem__(self, k: int) -> PolarScan:
        number: object = k  # a caller without a type checker may give anything
        if isinstance(number, slice):
            raise ConfigError("a recording gives one polar scan by its number; take several from polar_scans(start, stop)")
        return next(iter(self.polar_scans(k, k + 1)))

    @property
    def sensor_name(self) -> str:
        """Name of the sensor that took the recording, for messages: `radar` or `lidar`."""
        return name_sensor(is_lidar=isinstance(self, LidarRecording))

    @property
    def start_us(self) -> int:
        """Stamp [us] of the recording's start, from which all times in seconds count."""
        return int(self.stamps_us[0])

    @property
    def ends_us(self) -> NDArray[np.int64]:
        """Stamps (N,) int64 [us] of the ends of the revolutions; no end is later than the start of the next revolution."""
        ends = self.stamps_us + self.turns_us
        return np.append(np.minimum(ends[:-1], self.stamps_us[1:]), ends[-1:])

    @property
    def end_us(self) -> int:
        """Stamp [us] of the end of the last revolution."""
        return int(self.ends_us[-1])

    @property
    def duration_s(self) -> float:
        """Time from the first azimuth to the end of the last revolution [s]."""
        return (self.end_us - self.start_us) * 1e-6

    @property
    def start_times(self) -> NDArray[np.float64]:
        """Start (N,) of every revolution [s] since the recording's start."""
        return np.asarray((self.stamps_us - self.start_us) * 1e-6, dtype=np.float64)

    @property
    def end_times(self) -> NDArray[np.float64]:
        """End (N,) of every revolution [s] since the recording's start."""
        return np.asarray((self.ends_us - self.start_us) * 1e-6, dtype=np.float64)

    @property
    def revolution_s(self) -> float:
        """Duration of one revolution [s]: the median over the recording, but at least 0.05 s and at most 5 s."""
        return float(np.clip(np.median(self.turns_us), FASTEST_TURN_US, SLOWEST_TURN_US)) * 1e-6

    def complete(self, track: Trajectory) -> Trajectory:
        """Adds poses of the scans that the recording leaves out; a radar's recording leaves out no scan, and adds none."""
        return track

    @property
    def left_out(self) -> int:
        """Number of scans that are left out because a lidar had hardly moved; zero for a radar."""
        return 0

    def gaps(self) -> list[tuple[int, float]]:
        """Lists the gaps between polar scans: (index of the scan before the gap, length of the gap [s])."""
        missing = (self.stamps_us[1:] - self.ends_us[:-1]) * 1e-6
        return [(int(k), float(missing[k])) for k in np.flatnonzero(missing > 0.0)]


@dataclass(frozen=True)
class LidarRecording(Recording):
    """A recording of a planar lidar, whose scans hold ranges in place of power.

    The odometry consists of poses of the lidar itself.

    Args:
        scans: the scans, each lasting from its own stamp, at its first beam, to the stamp of the next scan. Times count
            from the first scan's stamp [s]; intensities are 0 where the recording has none.
        trajectory: poses of the sensor that some SLAM system stored with the scans, or None.
        every_us: (M,) [us] stamps of all scans of the recording if `scans` holds only some of them; None if it holds all.
    """

    scans: Scans = field(kw_only=True)
    trajectory: Trajectory | None = field(kw_only=True)
    every_us: NDArray[np.int64] | None = field(default=None, kw_only=True)

    @classmethod
    def of(
        cls,
        path: Path,
        format: str,
        scans: Scans,
        trajectory: Trajectory | None,
        odometry: Trajectory | None,
        notes: tuple[str, ...],
    ) -> Self:
        """Makes a recording of scans with the given fields; the duration of each scan follows from the scans' stamps."""
        turns_us = _measure_turns(scans)
        return cls(path, format, scans.stamps_us, turns_us, 0.0, odometry, notes=notes, scans=scans, trajectory=trajectory)

    @property
    def revolution_s(self) -> float:
        """Usual time from one scan to the next [s]."""
        return self.scans.revolution_s

    def take(self, chosen: Sequence[int]) -> Self:
        """Returns the recording with only the scans of these two or more indices; the last of them keeps its duration."""
        part = self._hold(self.scans.take(chosen))
        return replace(part, turns_us=np.append(part.turns_us[:-1], self.turns_us[chosen[-1]]))

    def cut(self, first: int, after: int) -> Self:
        """Returns the recording with only the scans first <= k < after, two or more; times count from the first of them."""
        return self._hold(self.scans[first:after].count_from_first())

    def _hold(self, part: Scans) -> Self:
        """Returns the recording with only these scans, and the durations that follow from their stamps."""
        part = replace(part, revolution_s=float(np.median(np.diff(part.start_times))))
        return replace(self, stamps_us=part.stamps_us, turns_us=_measure_turns(part), scans=part)

    @property
    def left_out(self) -> int:
        """Number of scans that are left out because the lidar had hardly moved."""
        return 0 if self.every_us is None else len(self.every_us) - len(self)

    def complete(self, track: Trajectory) -> Trajectory:
        """Adds poses of the scans that were left out: odometry, corrected to agree with the poses before and after them.

        The result has a pose at each of the stamps `every_us` from the track's first to its last stamp. Without odometry, or
        if no scans were left out, the track is returned unchanged.

        Args:
            track: poses of the scans that the recording holds.
        """
        if self.every_us is None or self.odometry is None:
            return track
        at, first, last = self.every_us, track.stamps_us[0], track.stamps_us[-1]
        at = at[(first <= at) & (at <= last)]
        k = np.clip(np.searchsorted(track.stamps_us, at, side="right") - 1, 0, len(track) - 2)
        held = self.odometry.at(track.stamps_us)
        step = se2.wrapped_between(held[k], self.odometry.at(at))
        miss = se2.subtract(
            se2.wrapped_between(track.poses[k], track.poses[k + 1]), se2.wrapped_between(held[k], held[k + 1])
        )
        share = (at - track.stamps_us[k]) / (track.stamps_us[k + 1] - track.stamps_us[k])
        return Trajectory(at, se2.compose(track.poses[k], step + share[:, None] * miss))

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Raises OfLidarError: a lidar measures ranges, and no power along the beam."""
        raise OfLidarError(self.path)


def _measure_turns(scans: Scans) -> NDArray[np.int64]:
    """Returns the times (N,) [us] from each scan to the next; the last scan is taken to last as long as usual."""
    return np.append(np.diff(scans.stamps_us), round(scans.revolution_s * 1e6)).astype(np.int64)


def stamp_scans(stamps_us: NDArray[np.int64], returns: Sequence[Returns]) -> Scans:
    """Makes scans that each last until the next one begins; the last one ends a median step after its stamp.

    Args:
        stamps_us: (N,) [us], strictly increasing, at least two.
        returns: returns of each of the N scans.
    """
    starts = (stamps_us - stamps_us[0]) * 1e-6
    edges = np.append(starts, starts[-1] + np.median(np.diff(starts))).tolist()
    scans = tuple(Scan(t0, t1, seen) for t0, t1, seen in zip(edges[:-1], edges[1:], returns, strict=True))
    return Scans(scans, int(stamps_us[0]), float(np.median(np.diff(stamps_us))) * 1e-6)
