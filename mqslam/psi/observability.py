"""Directions of motion that a map does not show.

Along a bare wall the returns of two views are scattered alike at any shift: at a wide scale psi's curvature, which knows
that neighbours are re-selected, vanishes there, while single returns still pair up by chance and pretend to a minimum.
The share of Gauss-Newton's curvature that remains at the widest scale tells the two apart: 0.22 and more where there are
windows, poles and corners (the real sample, the twin, the simulator's streets), 0.12 and less along a bare corridor.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.psi.estimator import Evaluation

LEAST = 0.16  # share of curvature below which a direction counts as not observed


def weak_directions(wide: Evaluation, size: int) -> NDArray[np.float64]:
    """Directions (K, size) of the first `size` state variables that psi does not observe, scaled to unit information.

    Args:
        wide: an evaluation at the widest scale, near the minimum.
    """
    information = wide.information[:size, :size]
    if not wide.matched.any() or np.linalg.matrix_rank(information) < size:
        return np.eye(size)
    units = np.linalg.cholesky(np.linalg.inv(information))
    shares, vectors = np.linalg.eigh(units.T @ wide.curvature[:size, :size] @ units)
    return np.asarray((units @ vectors[:, shares < LEAST]).T)


def loosened(
    covariance: NDArray[np.float64], directions: NDArray[np.float64], spans: NDArray[np.float64]
) -> NDArray[np.float64]:
    """A covariance (Q, Q) with the weak directions (K, Q) as uncertain as they can be.

    Args:
        spans: (Q,) standard deviation of each variable when nothing is known of it.
    """
    for direction in directions:
        length = np.min(spans / np.maximum(np.abs(direction), 1e-12))  # until the first variable reaches its span
        covariance = covariance + np.outer(direction, direction) * length**2
    return covariance
