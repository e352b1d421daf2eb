"""Fits parameters robustly to the offsets of spans, with standard deviations by a jackknife."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from mqslam.core.statistics import SIGMAS_PER_DEVIATION

HUBER: Final = 1.345
"""By definition: threshold of Huber's loss in standard deviations, for an efficiency of 95 % on normal errors."""
_BLOCKS: Final = 20  # largest number of parts of a drive: more parts would hardly show the spread any better
_FITS: Final = 3  # numerical: number of fits; after the second one the spread hardly changes
_LEAST: Final = 1e-12  # numerical: keeps quotients finite where all places agree to the last digit


class Estimate(NamedTuple):
    """An estimate of Q parameters from many places.

    Args:
        value: (Q,) parameters.
        sigma: (Q,) standard deviations of the parameters.
        p_value: (Q,) probability of estimating each parameter this far from zero if it is zero.
    """

    value: NDArray[np.float64]
    sigma: NDArray[np.float64]
    p_value: NDArray[np.float64]


def measure_spread(misses: NDArray[np.float64]) -> float:
    """Returns the robust standard deviation of residuals (N,) about zero, from the median of their absolute values."""
    return max(float(np.median(np.abs(misses))) * SIGMAS_PER_DEVIATION, _LEAST)


def fit_effects(design: NDArray[np.float64], offsets: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the parameters (Q,) whose effects fit offsets best, by Huber's loss in units of the residuals' spread.

    Args:
        design: (N, D, Q) effect of each of Q parameters on each of N offsets in each of D directions.
        offsets: (N, D) offsets [m] or [rad]; each direction has its own spread of residuals.
    """
    found = np.zeros(design.shape[2])
    for _ in range(_FITS):
        spreads = np.array([measure_spread(column) for column in (offsets - design @ found).T])

        def miss(x: NDArray[np.float64], spreads: NDArray[np.float64] = spreads) -> NDArray[np.float64]:
            return np.asarray(((offsets - design @ x) / spreads).ravel())

        found = least_squares(miss, found, loss="huber", f_scale=HUBER, x_scale="jac").x
    return np.asarray(found)


def split_into_blocks(count: int) -> list[NDArray[np.int64]]:
    """Divides the indices of `count` spans into blocks of successive spans; a jackknife leaves out each block once.

    Errors of neighbouring places are alike, and two successive spans share half of their path. A block therefore holds at
    least two spans, and more in a long drive.
    """
    return np.array_split(np.arange(count), int(np.clip(count // 2, 2, _BLOCKS)))


def fit_by_jackknife(
    fit: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]],
    given: tuple[NDArray[np.float64], NDArray[np.float64]],
    parts: Sequence[NDArray[np.int64]],
    common: float = 0.0,
) -> Estimate:
    """Fits parameters to all places, and again without each part of the places, to find how uncertain the parameters are.

    Args:
        fit: returns the parameters (Q,) that fit two arrays best.
        given: the two arrays, such as lengths and offsets; their first axis runs over N places.
        parts: indices of the places of each part.
        common: standard deviation of the parameters due to an error that all places have in common; the fits without single
            parts do not show this error.
    """
    found = fit(*given)
    without = np.array([fit(*(np.delete(array, part, axis=0) for array in given)) for part in parts])
    spread = np.sqrt((len(parts) - 1.0) / len(parts) * np.sum((without - found) ** 2, axis=0))
    sigma = np.maximum(np.hypot(spread, common), _LEAST)
    return Estimate(found, sigma, 2.0 * student.sf(np.abs(found) / sigma, len(parts) - 1))
