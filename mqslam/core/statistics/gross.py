"""Differences of which a few are gross: those of wrong matches say nothing of the right ones."""

from __future__ import annotations

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
