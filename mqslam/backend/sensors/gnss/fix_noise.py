"""The noise of fixes from the recording itself: what is white in it, and what wanders.

Errors of successive fixes are alike, as satellites, atmosphere and reflections change slowly. The positions that a receiver
fixes therefore wander about the true ones, and the mean of many fixes is not much better than that of a few. How much shows
in the differences of means over more and more fixes, held against the trajectory: those of white noise fall with the number
of fixes, those of a random walk rise with it (as in the Allan variance, IEEE Std 952). How far the trajectory itself drifts
meanwhile is taken for the receiver's.

A receiver that smooths its positions hides over short times how far it wanders over long ones. Where means over longer times
are farther apart than a walk over all times explains, the walk is therefore that of the longer times.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.optimize import nnls

from mqslam.core.statistics import MEDIAN_OF_CHI2, MEDIAN_SPREAD

_FEWEST: Final = 9  # differences per fix in a mean below which their median says nothing
_OUTAGE: Final = 2.0  # two means that take more than so many times the usual time lie on both sides of an outage
_CONTRADICTION: Final = 2.0  # standard deviations by which a difference is more than chance
_AROUND: Final = 31  # fixes among which jumps are seen, fewer than half of which may be jumps
_JUMP: Final = 9.0  # median distances from the fixes around: six standard deviations of noise
_LEAST_M: Final = 1e-3  # numerical: fixes without any error [m]


class FixNoise(NamedTuple):
    """The noise of fixes along each axis.

    Args:
        white_m: standard deviation of what is independent from fix to fix [m].
        walk_m: standard deviation by which the rest wanders in a second; it grows with the root of time [m].
    """

    white_m: float
    walk_m: float


def measure_fix_noise(
    times: NDArray[np.float64], residuals: NDArray[np.float64], stated_m: NDArray[np.float64], longest_s: float
) -> FixNoise:
    """Measures the noise of fixes; a receiver is never taken to be better than it says.

    Args:
        times: (F,) of the fixes [s], increasing.
        residuals: (F, 2) from the trajectory that is laid on them [m].
        stated_m: (F,) standard deviations that the receiver states, or NaN.
        longest_s: longest time over which means are taken [s].
    """
    own = stated_m[np.isfinite(stated_m) & (stated_m > 0.0)]
    least_m = max(float(np.median(own)) if len(own) else 0.0, _LEAST_M)
    columns, measured, sigmas = _compare_means(times, residuals, longest_s)
    if not len(measured):
        return FixNoise(least_m, 0.0)
    white = _fit(columns, measured, sigmas)[0]
    columns, measured, sigmas = _compare_means(times, _take_jumps_out(residuals), longest_s)
    rest, walk = _fit(columns, measured, sigmas)
    for first in range(len(measured) - 1):
        if np.all(measured[first:] - columns[first:] @ [rest, walk] < _CONTRADICTION * sigmas[first:]):
            break
        longer = slice(first + 1, None)
        walk = max(walk, _fit(columns[longer, 1:], measured[longer] - rest * columns[longer, 0], sigmas[longer])[0])
    return FixNoise(max(float(np.sqrt(white)), least_m), float(np.sqrt(walk)))


def _compare_means(
    times: NDArray[np.float64], residuals: NDArray[np.float64], longest_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Compares means of fixes with the next ones, over one, two, four and more fixes: K lengths of time.

    Args:
        times: (F,) of the fixes [s], increasing.
        residuals: (F, 2) from the trajectory that is laid on them [m].
        longest_s: longest time over which means are taken [s].

    Returns:
        (K, 2) what white noise and a walk of variance one would make of half the squared differences, (K,) these [m^2], and
        (K,) their standard deviations.
    """
    usual_s = float(np.median(np.diff(times)))
    sums = np.vstack([np.zeros(2), np.cumsum(residuals, axis=0)])
    counts, variances, sizes = list[int](), list[float](), list[float]()
    count = 1
    while count * usual_s <= longest_s and 2 * count < len(times):
        means = (sums[count:] - sums[:-count]) / count
        apart, lasts = means[count:] - means[:-count], times[2 * count - 1 :] - times[: len(times) - 2 * count + 1]
        apart = apart[lasts < _OUTAGE * 2 * count * usual_s]
        if len(apart) < _FEWEST * count:
            break
        counts.append(count)
        variances.append(float(np.median(apart**2)) / MEDIAN_OF_CHI2 / 2.0)
        sizes.append(len(apart) / count)
        count *= 2
    n, measured = np.array(counts, dtype=np.float64), np.array(variances)
    sigmas = measured * MEDIAN_SPREAD / np.sqrt(sizes) + _LEAST_M**2
    return np.column_stack([1.0 / n, n * usual_s / 3.0]), measured, sigmas


def _fit(columns: NDArray[np.float64], measured: NDArray[np.float64], sigmas: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the variances (C,) that explain those measured (N,) best, through columns (N, C) and by sigmas (N,)."""
    return np.asarray(nnls(columns / sigmas[:, None], measured / sigmas)[0])


def _take_jumps_out(residuals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns residuals (F, 2) with the median of those around in the place of a jump, which would raise every mean."""
    usual = median_filter(residuals, size=(_AROUND, 1), mode="nearest")
    off = np.abs(residuals - usual)
    return np.where(off > _JUMP * np.median(off), usual, residuals)
