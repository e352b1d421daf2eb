"""Robust statistics: variances that outliers do not affect, p-values, medians of very many numbers, evenly spread picks."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

MEDIAN_OF_CHI2: Final = 0.4549
"""Median of a chi-square with one degree of freedom; the median of squared errors divided by it estimates the variance."""
MEDIAN_SPREAD: Final = 2.33
"""A variance estimated from the median of n squares has a relative standard deviation of this number divided by sqrt(n)."""
SIGMAS_PER_DEVIATION: Final = 1.4826
"""Ratio of the standard deviation of normal noise to its median absolute deviation."""


def cut_gross(squares: NDArray[np.float64], times: float) -> NDArray[np.float64]:
    """Returns squares (N, K), each limited to the median of its column multiplied by `times`.

    NaN stays NaN, and a column whose median is zero is not limited.
    """
    known = np.isfinite(squares)
    median = np.array(
        [np.median(column[there]) if there.any() else 0.0 for column, there in zip(squares.T, known.T, strict=True)]
    )
    return np.where(median > 0.0, np.minimum(squares, times * median), squares)


MEDIAN_EFFICIENCY: Final = 0.37
"""Efficiency of the median absolute deviation relative to the standard deviation, for normal noise."""
_KEPT: Final = 0.998  # share of normal noise that a trimmed scale keeps: the values within 3.1 standard deviations


def correct_for_places(p_values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Corrects p-values (N,) of single places for the number of places (Bonferroni), and returns them (N,).

    A corrected p-value is an upper limit to the probability that a good map shows the uncorrected p-value, or a smaller one,
    at any of the places.

    Args:
        p_values: p-values of single places; NaN for places that were not judged, which do not count.
    """
    return np.minimum(np.count_nonzero(np.isfinite(p_values)) * p_values, 1.0)


def find_trimmed_scale(squares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Estimates the factors (3,) of `find_usual_scale` by a mean that leaves out places with very large offsets.

    With few places, this mean is less uncertain than the median. Places where the map is torn do not affect the mean as
    long as they are fewer than half of all places.

    Args:
        squares: (N, 3) squared offset of each place along x, y and yaw, each divided by its variance.
    """
    from scipy.stats import chi2  # here, since it loads half of SciPy and every command imports this module

    farthest = chi2.ppf(_KEPT, 1)
    kept = np.where(squares <= farthest * find_usual_scale(squares), squares, np.nan)
    usual = chi2.cdf(farthest, 3) / _KEPT  # mean square of normal noise without its farthest values
    return np.asarray(np.maximum(np.nanmean(kept, axis=0) / usual, 1.0))


def compute_p_values(squares: NDArray[np.float64], freedom: float) -> NDArray[np.float64]:
    """Returns the p-value (N,) of each place: the probability that a good map shows an offset at least as large there.

    Args:
        squares: (N,) squared Mahalanobis distances of the offsets (x, y, yaw), under covariances that were multiplied by
            factors such as those of `find_usual_scale`.
        freedom: degrees of freedom with which these factors were estimated.
    """
    from scipy.stats import f as f_distribution

    return np.asarray(f_distribution.sf(squares / 3.0, 3, freedom))


def find_smallest(p_values: Iterable[float]) -> float | None:
    """Returns the smallest corrected p-value, which is the p-value of all places together; None if no p-value is finite."""
    return min((float(p) for p in p_values if np.isfinite(p)), default=None)


def find_usual_scale(squares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the factors (3,), at least 1, by which variances must be multiplied to fit the median offset of all places.

    A covariance computed from the curvature of psi is too small by a factor that depends on the surroundings. The median
    of all places shows this factor, and the few places where the map is torn do not affect the median.

    Args:
        squares: (N, 3) squared offset of each place along x, y and yaw, each divided by its variance.
    """
    return np.asarray(np.maximum(np.median(squares, axis=0) / MEDIAN_OF_CHI2, 1.0))


_FINE = 44  # low bits of a float64 that do not count when numbers are sorted into 524,288 steps, each 0.2 to 0.4 % wide


def find_median(list_blocks: Callable[[], Iterable[NDArray[np.float64]]]) -> float:
    """Returns the median of all numbers in blocks of numbers that are not negative; NaN without any number.

    The blocks are read twice: first to count the numbers in each step (bin), then to sort the numbers in the steps
    around the median. A step holds all numbers with the same leading bits, and larger numbers are in later steps.

    Args:
        list_blocks: returns all blocks each time it is called.
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
    """Returns, for each of the numbers (N,), the index of the step (see `find_median`) that holds it."""
    return np.ascontiguousarray(numbers).view(np.int64) >> _FINE


def pick_evenly(count: int, most: int) -> NDArray[np.int64]:
    """Returns at most `most` evenly spread indices from 0 to count - 1, in increasing order.

    The first and the last index are among them, or only the first if `most` is 1.
    """
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.int64) if count else np.arange(0)
