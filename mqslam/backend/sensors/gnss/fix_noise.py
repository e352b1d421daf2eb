"""The noise of fixes from the recording itself: what is white in it, and what wanders.

Errors of successive fixes are alike, as satellites, atmosphere and reflections change slowly. The positions that a receiver
fixes therefore wander about the true ones, and the mean of many fixes is not much better than that of a few. How much shows
in the differences of means over more and more fixes, held against the trajectory: those of white noise fall with the number
of fixes, those of a random walk rise with it (as in the Allan variance, IEEE Std 952). How far the trajectory itself drifts
meanwhile is taken for the receiver's.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from mqslam.core.statistics.gross import MEDIAN_OF_CHI2, MEDIAN_SPREAD

_FEWEST: Final = 9  # differences per fix in a mean below which their median says nothing
_OUTAGE: Final = 2.0  # two means that take more than so many times the usual time lie on both sides of an outage
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
    own = stated_m[np.isfinite(stated_m) & (stated_m > 0.0)]
    least_m = max(float(np.median(own)) if len(own) else 0.0, _LEAST_M)
    if not counts:
        return FixNoise(least_m, 0.0)
    n, measured = np.array(counts, dtype=np.float64), np.array(variances)
    sigmas = measured * MEDIAN_SPREAD / np.sqrt(sizes) + _LEAST_M**2
    columns = np.column_stack([1.0 / n, n * usual_s / 3.0]) / sigmas[:, None]
    white, walk = nnls(columns, measured / sigmas)[0]
    return FixNoise(max(float(np.sqrt(white)), least_m), float(np.sqrt(walk)))
