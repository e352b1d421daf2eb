"""A finished map of any origin: points in the world frame, each with the time it was measured."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class TimedCloud:
    """A planar cloud in the order of its times.

    Args:
        path: the file it was read from.
        points: (N, 2) [m], world frame.
        stamps_us: (N,) int64 [us], not decreasing, in the file's own clock.
        notes: what a user should know about how the file was understood.
        scan_us: usual duration of a scan [us], where the file states it, as the maps of our own runs do.
    """

    path: Path
    points: NDArray[np.float64]
    stamps_us: NDArray[np.int64]
    notes: tuple[str, ...]
    scan_us: int | None = None

    @property
    def is_of_radar(self) -> bool:
        """Whether the points are known to be a radar's: a run has written the file, and takes nothing but radar."""
        return self.scan_us is not None

    def __len__(self) -> int:
        return len(self.points)
