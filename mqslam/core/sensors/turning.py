"""How far the radar has turned over time, as a sensor beside it says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core.sensors.gyroscope import Gyroscope

_LONGEST: Final = 5.0  # a longer time between two readings, in usual ones, is a gap: by definition of a gap


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """The angle about one axis that a gyroscope has turned by, interpolated between its readings.

    Args:
        times: (N,) of the readings [s] since the recording's start, increasing.
        angles: (N,) turned so far [rad].
        gaps: (N,) how many gaps lie before each reading.
    """

    times: NDArray[np.float64]
    angles: NDArray[np.float64]
    gaps: NDArray[np.int64]

    @classmethod
    def integrate(cls, gyroscope: Gyroscope, start_us: int, axis: int) -> Turning:
        """Integrates the rates about one of a gyroscope's axes by the trapezoidal rule.

        Args:
            gyroscope: two readings or more.
            start_us: stamp [us] of the recording's time zero.
            axis: 0 for x, 1 for y, 2 for z.
        """
        times, rates = np.asarray((gyroscope.stamps_us - start_us) * 1e-6, dtype=np.float64), gyroscope.rates[:, axis]
        steps = np.diff(times)
        angles = np.concatenate([[0.0], np.cumsum(0.5 * (rates[1:] + rates[:-1]) * steps)])
        gaps = np.concatenate([[0], np.cumsum(steps > _LONGEST * np.median(steps))])
        return cls(times, angles, gaps)

    def between(self, begins: NDArray[np.float64], ends: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns the angles (M,) turned between times (M,) and later ones (M,) [s]; NaN across a gap and outside."""
        turned = np.interp(ends, self.times, self.angles) - np.interp(begins, self.times, self.angles)
        last = len(self.times) - 1
        first_after = np.searchsorted(self.times, begins, side="right")
        first_not_before = np.searchsorted(self.times, ends, side="left")
        known = (self.times[0] <= begins) & (ends <= self.times[-1])
        known &= self.gaps[np.clip(first_after - 1, 0, last)] == self.gaps[np.clip(first_not_before, 0, last)]
        return np.where(known, turned, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class KnownTurning:
    """How far the radar turns, as a calibrated gyroscope says.

    Args:
        turning: of the gyroscope's axis that is the radar's vertical.
        scale: turns of the radar per turn of that axis; negative where it is mounted upside down.
        delay_s: how late the gyroscope's clock is [s].
        bias: of its rate, in turns of the radar [rad/s].
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
