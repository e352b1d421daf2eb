"""What robust fits to spans share."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from mqslam.core.gross import SIGMAS_PER_DEVIATION

HUBER: Final = 1.345
"""By definition: standard deviations beyond which a place pulls no harder, for 95 % efficiency."""
_LEAST: Final = 1e-12  # numerical: keeps quotients finite where all places agree to the last digit


def measure_spread(misses: NDArray[np.float64]) -> float:
    """Returns the standard deviation of misses about zero, by their median size."""
    return max(float(np.median(np.abs(misses))) * SIGMAS_PER_DEVIATION, _LEAST)


def judge_by_jackknife(
    found: NDArray[np.float64], without: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns the standard deviations (Q,) and p-values (Q,) of what a fit has found.

    Args:
        found: (Q,) by all places.
        without: (B, Q) by all but those of each of B parts.
    """
    parts = len(without)
    sigma = np.maximum(np.sqrt((parts - 1.0) / parts * np.sum((without - found) ** 2, axis=0)), _LEAST)
    return sigma, 2.0 * student.sf(np.abs(found) / sigma, parts - 1)
