"""Returns that do not move with the world: reflections of the mount and the vehicle, which repeat in the sensor's frame.

They would pull every motion to zero. A polar cell that returns in most scans of a recording is one of them, unless the
sensor hardly moved, where everything repeats; then nothing is dropped.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mqslam.config import DetectorConfig
from mqslam.core.scans import Returns


def drop_fixed(scans: Sequence[Returns], config: DetectorConfig) -> list[Returns]:
    """Drops the returns that repeat in the sensor's own frame.

    Args:
        scans: the returns of each scan.
        config: settings.

    Returns:
        the returns of each scan that are left.
    """
    if len(scans) < config.fixed_scans:
        return list(scans)
    cells = [_find_cells(returns, config) for returns in scans]
    size = 1 + max((int(c.max()) for c in cells if len(c)), default=0)
    counts = np.zeros(size, dtype=np.int64)
    for c in cells:
        counts[np.unique(c)] += 1
    fixed = counts > config.fixed_share * sum(len(c) > 0 for c in cells)
    total = sum(len(c) for c in cells)
    if total == 0 or sum(int(fixed[c].sum()) for c in cells) > config.fixed_most * total:
        return list(scans)
    return [returns.take(~fixed[c]) for returns, c in zip(scans, cells, strict=True)]


def _find_cells(returns: Returns, config: DetectorConfig) -> NDArray[np.int64]:
    """Returns the polar cell (N,) of each return."""
    around = config.fixed_sectors
    column = np.floor((returns.azimuths % (2.0 * np.pi)) / (2.0 * np.pi / around)).astype(np.int64)
    ring = np.floor(returns.ranges / config.fixed_range_m).astype(np.int64)
    return np.asarray(ring * around + np.minimum(column, around - 1), dtype=np.int64)
