"""The median of numbers that are too many to be in memory together."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray


def find_median(list_blocks: Callable[[], Iterable[NDArray[np.float64]]], step: float) -> float:
    """Returns the median of the numbers in all blocks, none of which is negative; NaN where there are none.

    The blocks are looked at twice: to count the numbers in steps, and for those in the steps where the middle is.

    Args:
        list_blocks: returns the blocks, each time it is called.
        step: so small that few of the numbers lie in one.
    """
    counts = np.zeros(0, dtype=np.int64)
    for block in list_blocks():
        here = np.bincount((block / step).astype(np.int64), minlength=len(counts))
        counts = here + np.pad(counts, (0, len(here) - len(counts)))
    ends = np.cumsum(counts)
    total = int(ends[-1]) if len(ends) else 0
    if total == 0:
        return float("nan")
    middle = np.array([(total - 1) // 2, total // 2])
    low, high = np.searchsorted(ends, middle, side="right").tolist()
    steps = ((block, (block / step).astype(np.int64)) for block in list_blocks())
    inside = np.sort(np.concatenate([block[(low <= at) & (at <= high)] for block, at in steps]))
    before = int(ends[low - 1]) if low else 0
    return float(np.mean(inside[middle - before]))
