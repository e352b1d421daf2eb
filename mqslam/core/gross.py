"""Squared differences of which a few are gross: those of wrong matches say nothing of the right ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def cut_gross(squares: NDArray[np.float64], times: float) -> NDArray[np.float64]:
    """Returns squares (N, K) of which none is more than so many times the median of its column; NaN where they are NaN.

    A column of which more than half are zero has no such limit.
    """
    known = np.isfinite(squares)
    median = np.array(
        [np.median(column[there]) if there.any() else 0.0 for column, there in zip(squares.T, known.T, strict=True)]
    )
    return np.where(median > 0.0, np.minimum(squares, times * median), squares)
