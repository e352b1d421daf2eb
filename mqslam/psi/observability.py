"""Directions of motion that a map does not show.

Along a bare wall the returns of two views are scattered alike at any shift. At a wide scale psi's curvature, which knows
that neighbours are re-selected, vanishes there, while single returns still pair up by chance and pretend to a minimum.
The share of Gauss-Newton's curvature that remains at the widest scale tells the two apart: it is 0.22 and more where
there are windows, poles and corners (the real sample, the twin, the simulator's streets), and 0.12 and less along a bare
corridor.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.psi.scoring.estimator import PsiEvaluation

# A direction in which less than this share of Gauss-Newton's curvature remains at the widest scale counts as not observed:
# 0.22 and more remain in streets, 0.12 and less along a bare corridor.
_OBSERVED_SHARE = 0.16
_SHOWN = 1e-9  # correlated eigenvalues below this share of the largest one are rounding


def find_weak_directions(wide: PsiEvaluation, size: int) -> NDArray[np.float64]:
    """Finds the directions (K, size) that psi does not observe, scaled to unit information.

    Where the points do not even show all directions under Gauss-Newton, as returns of a single bearing do, nothing is
    taken as observed.

    Args:
        wide: an evaluation at the widest scale, near the minimum.
        size: number of state variables that are looked at, the first ones.
    """
    information = wide.information[:size, :size]
    units = np.sqrt(np.diag(information))
    if not np.all(units > 0.0):
        return np.eye(size)
    values, vectors = np.linalg.eigh(information / (units[:, None] * units[None, :]))
    if values[0] < _SHOWN * values[-1]:
        return np.eye(size)
    whiten = (vectors / np.sqrt(values)) / units[:, None]
    shares, directions = np.linalg.eigh(whiten.T @ wide.curvature[:size, :size] @ whiten)
    return np.asarray((whiten @ directions[:, shares < _OBSERVED_SHARE]).T)


def spread_along(directions: NDArray[np.float64], spans: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the covariance (Q, Q) of being anywhere along weak directions.

    Args:
        directions: (K, Q) the weak ones; without any the covariance is zero.
        spans: (Q,) standard deviation of each variable when nothing is known of it.
    """
    spread = np.zeros((len(spans), len(spans)))
    for direction in directions:
        length = np.min(spans / np.maximum(np.abs(direction), 1e-12))  # until the first variable reaches its span
        spread += np.outer(direction, direction) * length**2
    return spread
