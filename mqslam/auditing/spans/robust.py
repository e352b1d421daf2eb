"""What robust fits to spans share."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from mqslam.core.statistics import SIGMAS_PER_DEVIATION

HUBER: Final = 1.345
"""By definition: standard deviations beyond which a place pulls no harder, for 95 % efficiency."""
_BLOCKS: Final = 20  # parts of a long drive: more would hardly know their own spread any better
_FITS: Final = 3  # numerical: after the second one the spread hardly changes
_LEAST: Final = 1e-12  # numerical: keeps quotients finite where all places agree to the last digit


def measure_spread(misses: NDArray[np.float64]) -> float:
    """Returns the standard deviation of misses about zero, by their median size."""
    return max(float(np.median(np.abs(misses))) * SIGMAS_PER_DEVIATION, _LEAST)


def fit_effects(design: NDArray[np.float64], offsets: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the parameters (Q,) whose effects fit offsets best, by Huber's loss, and by the spread of what is left over.

    Args:
        design: (N, D, Q) effects of the parameters.
        offsets: (N, D); each of the D directions has a spread of its own.
    """
    found = np.zeros(design.shape[2])
    for _ in range(_FITS):
        spreads = np.array([measure_spread(column) for column in (offsets - design @ found).T])

        def miss(x: NDArray[np.float64], spreads: NDArray[np.float64] = spreads) -> NDArray[np.float64]:
            return np.asarray(((offsets - design @ x) / spreads).ravel())

        found = least_squares(miss, found, loss="huber", f_scale=HUBER, x_scale="jac").x
    return np.asarray(found)


def split_into_blocks(count: int) -> list[NDArray[np.int64]]:
    """Returns the indices of so many spans in blocks, each of which a jackknife leaves out once.

    Errors of places beside each other are alike, and two spans in a row share half of their path. A block therefore holds
    two of them at least, and more in a long drive.
    """
    return np.array_split(np.arange(count), int(np.clip(count // 2, 2, _BLOCKS)))


def judge_by_jackknife(
    found: NDArray[np.float64], without: NDArray[np.float64], common: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns the standard deviations (Q,) and p-values (Q,) of what a fit has found.

    Args:
        found: (Q,) by all places.
        without: (B, Q) by all but those of each of B parts.
        common: standard deviation of an error that all places have in common, which their spread does not show.
    """
    parts = len(without)
    spread = np.sqrt((parts - 1.0) / parts * np.sum((without - found) ** 2, axis=0))
    sigma = np.maximum(np.hypot(spread, common), _LEAST)
    return sigma, 2.0 * student.sf(np.abs(found) / sigma, parts - 1)
