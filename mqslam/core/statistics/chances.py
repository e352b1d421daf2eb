"""Chances: how likely what a test shows is where the map is good, corrected for the number of places looked at."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from mqslam.core.statistics.gross import MEDIAN_OF_CHI2

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
