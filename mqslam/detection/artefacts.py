"""Drops returns of the mount and of the vehicle itself, which repeat at the same place in the sensor's frame.

Such returns would pull every estimated motion to zero. The area around the sensor is divided into polar cells, each 0.5 m
long and 2 degrees wide. A cell that has returns in most scans of a recording belongs to the vehicle, and its returns are
dropped. If the sensor hardly moved, the returns of the world repeat as well; then nothing is dropped.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from mqslam.core.scans import Returns

# With fewer scans than this, all returns are kept: too few scans do not show which returns are the vehicle's own.
_FIXED_SCANS = 8
# Length of the polar cells in which repeating returns are counted [m], and number of cells around the full circle.
_FIXED_RANGE_M, _FIXED_SECTORS = 0.5, 180
# A cell with returns in more than this share of the scans is part of the vehicle. Scans without any return do not count.
_FIXED_SHARE = 0.7
# If more than this share of all returns repeats, the sensor stood still, and the repeating returns are of the world.
_FIXED_MOST = 0.2


def drop_fixed(scans: Sequence[Returns]) -> list[Returns]:
    """Drops from all scans the returns that `find_fixed` finds to repeat; returns the other returns of each scan."""
    fixed = find_fixed(scans)
    return list(scans) if fixed is None else [drop_cells(returns, fixed) for returns in scans]


def find_fixed(scans: Iterable[Returns]) -> NDArray[np.bool_] | None:
    """Finds the polar cells whose returns repeat in the sensor's frame.

    Args:
        scans: the returns of each scan; one scan is held in memory at a time.

    Returns:
        A mask (C,) by the index of the cell (`_find_cells`), up to the last cell with a return: True where returns repeat.
        None if nothing is to be dropped: no cell repeats, there are fewer than 8 scans, or so many returns repeat that the
        sensor stood still.
    """
    scans_in, returns_in = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)  # counts of scans and returns per cell
    count, filled = 0, 0
    for returns in scans:
        cells = _find_cells(returns)
        count, filled = count + 1, filled + (len(cells) > 0)
        here = np.bincount(cells)
        if len(here) > len(scans_in):
            scans_in, returns_in = (np.pad(sums, (0, len(here) - len(scans_in))) for sums in (scans_in, returns_in))
        scans_in[: len(here)] += here > 0
        returns_in[: len(here)] += here
    fixed = scans_in > _FIXED_SHARE * filled
    to_drop, total = int(returns_in[fixed].sum()), int(returns_in.sum())
    if count < _FIXED_SCANS or to_drop == 0 or to_drop > _FIXED_MOST * total:
        return None
    return fixed


def drop_cells(returns: Returns, fixed: NDArray[np.bool_]) -> Returns:
    """Drops a scan's returns in the cells that the mask `fixed` (C,) of `find_fixed` marks; returns the other returns."""
    return returns.take(~fixed[_find_cells(returns)])


def _find_cells(returns: Returns) -> NDArray[np.int64]:
    """Returns the index (N,) of each return's polar cell: 180 times its ring in range, plus its sector in azimuth."""
    column = np.floor((returns.azimuths % (2.0 * np.pi)) / (2.0 * np.pi / _FIXED_SECTORS)).astype(np.int64)
    ring = np.floor(returns.ranges / _FIXED_RANGE_M).astype(np.int64)
    return np.asarray(ring * _FIXED_SECTORS + np.minimum(column, _FIXED_SECTORS - 1), dtype=np.int64)
