"""The median of numbers that are too many to be in memory together."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

_FINE = 44  # last bits of a number that say where in its step it lies: steps are 0.2 to 0.4 % wide, and 524,288 in all


def find_median(list_blocks: Callable[[], Iterable[NDArray[np.float64]]]) -> float:
    """Returns the median of the numbers in all blocks, none of which is negative; NaN where there are none.

    The blocks are looked at twice: to count the numbers in steps, and for those in the steps where the middle is. A step
    holds the numbers with the same leading bits, which increase as the numbers do.

    Args:
        list_blocks: returns the blocks, each time it is called.
    """
    counts = np.zeros(1 << (63 - _FINE), dtype=np.int64)
    for block in list_blocks():
        steps, here = np.unique(_find_steps(block), return_counts=True)
        counts[steps] += here
    ends = np.cumsum(counts)
    total = int(ends[-1])
    if total == 0:
        return float("nan")
    middle = np.array([(total - 1) // 2, total // 2])
    low, high = np.searchsorted(ends, middle, side="right").tolist()
    placed = ((block, _find_steps(block)) for block in list_blocks())
    inside = np.sort(np.concatenate([block[(low <= at) & (at <= high)] for block, at in placed]))
    before = int(ends[low - 1]) if low else 0
    return float(np.mean(inside[middle - before]))


def _find_steps(numbers: NDArray[np.float64]) -> NDArray[np.int64]:
    """Returns the number of the step that each of the numbers (N,) lies in."""
    return np.ascontiguousarray(numbers).view(np.int64) >> _FINE
