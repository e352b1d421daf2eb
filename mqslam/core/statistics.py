"""Robust statistics: spreads that gross differences do not move, chances, medians of very many numbers, even picks."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

MEDIAN_OF_CHI2: Final = 0.4549
"""Median of a chi-square with one degree of freedom: divided by it, a median of squares is a variance."""
MEDIAN_SPREAD: Final = 2.33
"""Standard deviation of such a variance, as a share of it, times the root of the number of squares."""
SIGMAS_PER_DEVIATION: Final = 1.4826
"""Standard deviations of normal noise per median absolute deviation."""


def cut_gross(squares: NDArray[np.float64], times: float) -> NDArray[np.float64]:
    """Returns squares (N, K) of which none is more than so many times the median of its column; NaN where they are NaN.

    A column of which more than half are zero has no such limit.
    """
    known = np.isfinite(squares)
    median = np.array(
        [np.median(column[there]) if there.any() else 0.0 for column, there in zip(squares.T, known.T, strict=True)]
    )
    return np.where(median > 0.0, np.minimum(squares, times * median), squares)


MEDIAN_EFFICIENCY: Final = 0.37
"""By definition: efficiency of a median absolute deviation of normal noise, against the standard deviation."""
_KEPT: Final = 0.998  # by definition: share of normal noise that a trimmed scale keeps, within 3.1 standard deviations


def correct_for_places(p_values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns p-values (N,) as probabilities that one as small shows anywhere where the map is good (Bonferroni).

    Args:
        p_values: of single places; NaN where nothing was judged, which does not count as a place.
    """
    return np.minimum(np.count_nonzero(np.isfinite(p_values)) * p_values, 1.0)


def find_trimmed_scale(squares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the same factors as `find_usual_scale` from the mean of all places but those that are far off.

    It is less uncertain where the places are few, and not moved by those that are torn as long as these are less than half.

    Args:
        squares: (N, 3), as for `find_usual_scale`.
    """
    from scipy.stats import chi2  # loads half of SciPy, and every command needs this module

    farthest = chi2.ppf(_KEPT, 1)
    kept = np.where(squares <= farthest * find_usual_scale(squares), squares, np.nan)
    usual = chi2.cdf(farthest, 3) / _KEPT  # mean of the squares of normal noise of which the farthest are left out
    return np.asarray(np.maximum(np.nanmean(kept, axis=0) / usual, 1.0))


def compute_p_values(squares: NDArray[np.float64], freedom: float) -> NDArray[np.float64]:
    """Returns the probabilities that offsets as large as these show at places of a good map.

    Args:
        squares: (N,) of offsets (3,), in units of covariances that are scaled until the usual place is as far off as it
            should be.
        freedom: degrees of freedom of the scale, which is itself uncertain.
    """
    from scipy.stats import f as f_distribution

    return np.asarray(f_distribution.sf(squares / 3.0, 3, freedom))


def find_smallest(p_values: Iterable[float]) -> float | None:
    """Returns the smallest of the corrected p-values of places, which is that of all together; None without any."""
    return min((float(p) for p in p_values if np.isfinite(p)), default=None)


def find_usual_scale(squares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the factors (3,) on variances that make the usual place as far off as its covariance says; 1 at least.

    The curvature's covariance is too small by a factor that depends on the world. The median of all places shows it, and
    is not moved by the few that are torn.

    Args:
        squares: (N, 3) how far off each place is per axis, squared, in units of its variances.
    """
    return np.asarray(np.maximum(np.median(squares, axis=0) / MEDIAN_OF_CHI2, 1.0))


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


def pick_evenly(count: int, most: int) -> NDArray[np.int64]:
    """Returns at most `most` of the numbers 0..count - 1, the first and the last among them, increasing."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.int64) if count else np.arange(0)
