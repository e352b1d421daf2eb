"""Returns: what the detector keeps of a revolution, and windows of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Returns:
    """Detected targets in the sensor's polar frame, ordered by time.

    Args:
        ranges: (N,) [m].
        azimuths: (N,) [rad] counter-clockwise from straight ahead.
        times: (N,) [s] since the recording's start.
        intensities: (N,) received power, 0..255.
    """

    ranges: NDArray[np.float64]
    azimuths: NDArray[np.float64]
    times: NDArray[np.float64]
    intensities: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.ranges)

    def take(self, chosen: NDArray[np.bool_]) -> Returns:
        """The returns a mask (N,) chooses."""
        return Returns(self.ranges[chosen], self.azimuths[chosen], self.times[chosen], self.intensities[chosen])

    @classmethod
    def none(cls) -> Returns:
        """What a revolution holds that could not be read."""
        return cls(np.empty(0), np.empty(0), np.empty(0), np.empty(0))

    @classmethod
    def concatenate(cls, parts: Sequence[Returns]) -> Returns:
        """All returns of several parts, in their order."""
        return cls(
            np.concatenate([p.ranges for p in parts]),
            np.concatenate([p.azimuths for p in parts]),
            np.concatenate([p.times for p in parts]),
            np.concatenate([p.intensities for p in parts]),
        )


@dataclass(frozen=True, slots=True)
class Scan:
    """A stretch of the stream: the returns whose times lie in [t0, t1) [s since the recording's start]."""

    t0: float
    t1: float
    returns: Returns
