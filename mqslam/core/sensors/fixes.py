"""Positions on the Earth that a GNSS receiver measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Fixes:
    """GNSS fixes over time (WGS 84).

    Args:
        stamps_us: (N,) int64 [us], strictly increasing, in the recording's clock.
        latitudes: (N,) degrees, north is positive.
        longitudes: (N,) degrees, east is positive.
        sigmas_m: (N,) standard deviation of the position along each horizontal axis, as the receiver states it [m]; NaN
            where it states none.
        source: the file or topic that they come from, for messages.
        made_truth: whether the recording's ground truth was made from this receiver: then the fixes, used for an estimate,
            would make the evaluation of that estimate meaningless.
        own_clock: whether the receiver's clock is known not to be that of the radar.
    """

    stamps_us: NDArray[np.int64]
    latitudes: NDArray[np.float64]
    longitudes: NDArray[np.float64]
    sigmas_m: NDArray[np.float64]
    source: str
    made_truth: bool = False
    own_clock: bool = False

    def __len__(self) -> int:
        return len(self.stamps_us)

    @property
    def rate_hz(self) -> float:
        """Fixes per second: the median over the recording; NaN with fewer than two."""
        return float(1e6 / np.median(np.diff(self.stamps_us))) if len(self) > 1 else float("nan")
