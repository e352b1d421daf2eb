"""Descriptors of places: how many returns lie where around a place, in rings and sectors.

Source: Scan Context (Kim and Kim, IROS 2018), with numbers of returns in place of heights, which a radar does not see. From
another lane, returns lie in other rings and sectors; therefore a place is looked up as seen from several places beside it.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

# Returns farther from a place than this [m] do not describe it.
RANGE_M = 120.0
# Number of rings around a place in which returns are counted: each is 3 m wide, as a place is recognised to within a lane.
RINGS = 40
# Number of sectors around a place in which returns are counted: each is 3 degrees wide.
SECTORS = 120


def describe(points: NDArray[np.float64], aside_m: float = 0.0) -> NDArray[np.float32]:
    """Describes a place by the square roots of the numbers of returns in rings and sectors, of norm one.

    Args:
        points: (N, 2) m, in a frame at the place.
        aside_m: how far to the left of the place the rings are centred [m].

    Returns:
        (R, S) rings from the inside out, sectors counter-clockwise from straight ahead; zeros where no return is in range.
    """
    counts = _count(np.asarray(points, dtype=np.float64), aside_m, RANGE_M, RINGS, SECTORS)
    roots = np.sqrt(counts)
    norm = float(np.linalg.norm(roots))
    return np.asarray(roots / norm if norm > 0.0 else roots, dtype=np.float32)


@nb.njit(cache=True, nogil=True)
def _count(points: NDArray[np.float64], aside_m: float, range_m: float, rings: int, sectors: int) -> NDArray[np.float64]:
    """Counts points (N, 2) in rings and sectors (R, S) around a place to the left of the origin."""
    counts = np.zeros((rings, sectors))
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1] - aside_m
        ring = int(np.hypot(x, y) / range_m * rings)
        if ring < rings:
            sector = int(np.floor(np.arctan2(y, x) / (2.0 * np.pi) * sectors)) % sectors
            counts[ring, sector] += 1.0
    return counts
