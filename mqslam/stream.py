"""A radar recording as a stream of azimuths, one revolution in memory at a time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from mqslam.trajectory import Trajectory

_AROUND = 9  # steps whose median is the usual one between them


@dataclass(frozen=True, slots=True)
class Revolution:
    """One turn of the radar.

    Args:
        times: (A,) [s] since the stream's start, one per azimuth, not decreasing.
        azimuths: (A,) [rad] counter-clockwise from straight ahead (REP 103), unwrapped along the turn.
        power: (A, B) uint8 received power, one row per azimuth; bin b is centred at (b + 0.5) range resolutions.
        valid: (A,) bool, False where the recording marks the azimuth as not measured.
    """

    times: NDArray[np.float64]
    azimuths: NDArray[np.float64]
    power: NDArray[np.uint8]
    valid: NDArray[np.bool_]


@dataclass(frozen=True)
class RadarStream(ABC):
    """A recording, indexed but not read: it pickles as paths and numbers, and workers read what they need.

    Args:
        path: the recording.
        format: name of its layout, as `mqslam info` prints it.
        stamps_us: (N,) int64 [us], stamp of the first azimuth of every revolution, strictly increasing.
        end_us: stamp [us] of the last revolution's end.
        range_resolution: length of a range bin [m].
        odometry: dead-reckoned poses the recording carries, or None.
        ground_truth: poses known better than any estimate, for evaluation only, or None.
        notes: what a user should know about how the recording was understood.
        faults: what is wrong with the recording and was left out or put right.
    """

    path: Path
    format: str
    stamps_us: NDArray[np.int64]
    end_us: int
    range_resolution: float
    odometry: Trajectory | None = None
    ground_truth: Trajectory | None = None
    notes: tuple[str, ...] = field(default=())
    faults: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.stamps_us)

    @abstractmethod
    def revolutions(self, start: int = 0, stop: int | None = None) -> Iterator[Revolution]:
        """Read the revolutions start <= k < stop, one after the other, holding one at a time.

        Raises:
            DataError: a revolution that cannot be read, naming its file.
        """

    def __getitem__(self, k: int) -> Revolution:
        return next(iter(self.revolutions(k, k + 1)))

    @property
    def start_us(self) -> int:
        """Stamp [us] of the stream's start: time zero inside."""
        return int(self.stamps_us[0])

    @property
    def duration_s(self) -> float:
        """From the first azimuth to the end of the last revolution [s]."""
        return (self.end_us - self.start_us) * 1e-6

    @property
    def start_times(self) -> NDArray[np.float64]:
        """(N,) start of every revolution [s] since the stream's start."""
        return np.asarray((self.stamps_us - self.start_us) * 1e-6, dtype=np.float64)

    @property
    def period_s(self) -> float:
        """Duration of one revolution [s]: the median over the recording."""
        if len(self) == 1:
            return self.duration_s
        return float(np.median(np.diff(self.stamps_us))) * 1e-6

    def gaps(self) -> list[tuple[int, float]]:
        """Revolutions followed by a hole: (index, seconds missing) where over half a revolution is."""
        usual = usual_steps(self.stamps_us) * 1e-6
        missing = np.diff(self.stamps_us) * 1e-6 - usual
        return [(int(k), float(missing[k])) for k in np.flatnonzero(missing > 0.5 * usual)]


def usual_steps(stamps_us: NDArray[np.int64]) -> NDArray[np.float64]:
    """Usual duration (N - 1,) [us] of a turn at each step between increasing stamps (N,) [us], gaps apart.

    It is the median of the steps around, since a radar may be told to turn at another rate.
    """
    steps = np.diff(stamps_us).astype(np.float64)
    if len(steps) < _AROUND:
        return np.full(len(steps), np.median(steps) if len(steps) else 0.0)
    mirrored = np.pad(steps, _AROUND // 2, mode="symmetric")
    return np.asarray(np.median(sliding_window_view(mirrored, _AROUND), axis=-1))
