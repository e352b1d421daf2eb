"""A gyroscope's readings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Gyroscope:
    """Angular rates over time, in the clock and about the axes of the sensor that measured them.

    Args:
        stamps_us: (N,) int64 [us], strictly increasing.
        rates: (N, 3) rad/s about x forward, y left and z up of the gyroscope, as its layout states its axes.
        source: the file or topic that they come from, for messages.
        own_clock: whether its clock is known not to be that of the radar, so that no error of it says anything.
    """

    stamps_us: NDArray[np.int64]
    rates: NDArray[np.float64]
    source: str
    own_clock: bool = False

    def __len__(self) -> int:
        return len(self.stamps_us)

    @property
    def rate_hz(self) -> float:
        """Readings per second: the median over the recording; NaN with fewer than two."""
        return float(1e6 / np.median(np.diff(self.stamps_us))) if len(self) > 1 else float("nan")
