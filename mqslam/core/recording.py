"""A radar recording: opened and indexed, one polar scan in memory at a time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core.trajectory import Trajectory

FASTEST_TURN_US = 50_000
SLOWEST_TURN_US = 5_000_000
"""No spinning radar turns 20 times a second, or only once in five: other durations are no turns [us]."""


@dataclass(frozen=True, slots=True)
class PolarScan:
    """One turn of the radar.

    Args:
        times: (A,) [s] since the recording's start, one per azimuth, not decreasing.
        azimuths: (A,) [rad] counter-clockwise from straight ahead (REP 103), unwrapped along the turn.
        power: (A, B) uint8 received power, one row per azimuth; bin b is centred at (b + 0.5) range resolutions.
        valid: (A,) bool, False where the recording marks the azimuth as not measured.
    """

    times: NDArray[np.float64]
    azimuths: NDArray[np.float64]
    power: NDArray[np.uint8]
    valid: NDArray[np.bool_]


@dataclass(frozen=True)
class Recording(ABC):
    """A recording, indexed but not read: it pickles as paths and numbers, and workers read what they need.

    Args:
        path: the recording.
        format: name of its layout, as `mqslam info` prints it.
        stamps_us: (N,) int64 [us], stamp of the first azimuth of every revolution, strictly increasing.
        turns_us: (N,) int64 [us], how long each revolution takes: until the next one begins, but for a gap after it.
        range_resolution: length of a range bin [m].
        odometry: dead-reckoned poses the recording carries, or None.
        ground_truth: poses known better than any estimate, for evaluation only, or None.
        notes: what a user should know about how the recording was understood.
        faults: what is wrong with the recording and was left out or put right.
    """

    path: Path
    format: str
    stamps_us: NDArray[np.int64]
    turns_us: NDArray[np.int64]
    range_resolution: float
    odometry: Trajectory | None = None
    ground_truth: Trajectory | None = None
    notes: tuple[str, ...] = field(default=())
    faults: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.stamps_us)

    @abstractmethod
    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Read the revolutions start <= k < stop, one after the other, holding one at a time.

        Raises:
            DataError: a revolution that cannot be read, naming its file.
        """

    def __getitem__(self, k: int) -> PolarScan:
        return next(iter(self.polar_scans(k, k + 1)))

    @property
    def start_us(self) -> int:
        """Stamp [us] of the recording's start: time zero inside."""
        return int(self.stamps_us[0])

    @property
    def ends_us(self) -> NDArray[np.int64]:
        """(N,) int64 stamps [us] of the ends of the revolutions; none is later than the start of the next one."""
        ends = self.stamps_us + self.turns_us
        return np.append(np.minimum(ends[:-1], self.stamps_us[1:]), ends[-1:])

    @property
    def end_us(self) -> int:
        """Stamp [us] of the last revolution's end."""
        return int(self.ends_us[-1])

    @property
    def duration_s(self) -> float:
        """From the first azimuth to the end of the last revolution [s]."""
        return (self.end_us - self.start_us) * 1e-6

    @property
    def start_times(self) -> NDArray[np.float64]:
        """(N,) start of every revolution [s] since the recording's start."""
        return np.asarray((self.stamps_us - self.start_us) * 1e-6, dtype=np.float64)

    @property
    def end_times(self) -> NDArray[np.float64]:
        """(N,) end of every revolution [s] since the recording's start."""
        return np.asarray((self.ends_us - self.start_us) * 1e-6, dtype=np.float64)

    @property
    def revolution_s(self) -> float:
        """Duration of one revolution [s]: the median over the recording, kept to what a radar can do."""
        return float(np.clip(np.median(self.turns_us), FASTEST_TURN_US, SLOWEST_TURN_US)) * 1e-6

    def gaps(self) -> list[tuple[int, float]]:
        """Revolutions that end before the next one begins: (index, seconds missing)."""
        missing = (self.stamps_us[1:] - self.ends_us[:-1]) * 1e-6
        return [(int(k), float(missing[k])) for k in np.flatnonzero(missing > 0.0)]
