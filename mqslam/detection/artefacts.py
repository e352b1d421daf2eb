"""Returns that do not move with the world: reflections of the mount and the vehicle, which repeat in the sensor's frame.

They would pull every motion to zero. A polar cell that returns in most revolutions of a recording is one of them, unless
the sensor hardly moved, where everything repeats; then nothing is dropped.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mqslam.core.scans import Returns

RANGE_M = 0.5  # polar cell, along the ray
AZIMUTH_RAD = np.deg2rad(2.0)  # and across
REPEATS = 0.7  # share of revolutions in which a cell of the sensor's own returns
FEWEST = 8  # revolutions needed to tell
MOST = 0.2  # larger shares of all returns are the world seen from rest, not artefacts


def drop_fixed(revolutions: Sequence[Returns]) -> list[Returns]:
    """The same revolutions without the returns that repeat in the sensor's frame."""
    if len(revolutions) < FEWEST:
        return list(revolutions)
    cells = [_cells(returns) for returns in revolutions]
    size = 1 + max((int(c.max()) for c in cells if len(c)), default=0)
    seen = np.zeros(size, dtype=np.int64)
    for c in cells:
        seen[np.unique(c)] += 1
    fixed = seen > REPEATS * sum(len(c) > 0 for c in cells)
    total = sum(len(c) for c in cells)
    if total == 0 or sum(int(fixed[c].sum()) for c in cells) > MOST * total:
        return list(revolutions)
    return [returns.take(~fixed[c]) for returns, c in zip(revolutions, cells, strict=True)]


def _cells(returns: Returns) -> NDArray[np.int64]:
    """Polar cell of each return."""
    around = int(np.ceil(2.0 * np.pi / AZIMUTH_RAD))
    column = np.floor((returns.azimuths % (2.0 * np.pi)) / AZIMUTH_RAD).astype(np.int64)
    ring = np.floor(returns.ranges / RANGE_M).astype(np.int64)
    return np.asarray(ring * around + np.minimum(column, around - 1), dtype=np.int64)
