"""Covariance of the minimum of psi from its curvature.

psi is a sum over points, so its minimiser is an M-estimator and curvature alone has no scale: with H the curvature that
knows of re-selection, and g_c the summed score of the returns of one object (a square cell of the map),

    Sigma = n / (n - q) H^-1 (sum_c g_c g_c^T) H^-1        for n objects and q variables.

Where a direction is hardly observed H is hardly positive there, and Sigma comes out large along it. The first factor is
the usual one for few samples: q variables can make the scores of q objects vanish, whatever their errors are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mqslam.psi.estimator import Evaluation

CLUSTER_M = 2.0  # returns this close are of one object and err together
_UNKNOWN = 1e6  # variance, over that of the curvature alone, where there are no more objects than variables
_LEAST = 1e-3  # share of Gauss-Newton's curvature below which a direction counts as not observed at all


def sandwich(
    found: Evaluation, points: NDArray[np.float64], known: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Covariance (Q, Q) of the state at a minimum.

    Args:
        found: the evaluation at the minimum.
        points: (N, 2) m, where the returns lie, to tell which belong to one object.
        known: (Q, Q) information about the state besides psi, in the curvature's scale.
    """
    if known is None:
        known = np.zeros_like(found.curvature)
    units = 1.0 / np.sqrt(np.maximum(np.diag(found.information + known), 1e-12))
    scale = units[:, None] * units[None, :]
    sums = sum_by_object(found.scores[found.matched], points[found.matched])
    objects, variables = sums.shape
    if objects <= variables:
        return np.diag(_UNKNOWN * units**2)
    values, vectors = np.linalg.eigh((found.curvature + known) * scale)
    spread = vectors.T @ ((sums.T @ sums * (objects / (objects - variables)) + known) * scale) @ vectors
    inverse = 1.0 / np.maximum(values, _LEAST)
    # a direction that psi does not hold at all varies by as much as its curvature fails to bound it
    spread += np.diag(np.where(values < _LEAST, 1.0, 0.0) * _LEAST)
    covariance = (vectors * inverse) @ spread @ (vectors * inverse).T * scale
    return np.asarray(0.5 * (covariance + covariance.T))


def sandwich_by_differences(
    found: Evaluation,
    points: NDArray[np.float64],
    gradient: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    state: NDArray[np.float64],
    steps: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The same where all points move with the state: there the evaluation's own curvature is up to four times too large.

    Args:
        found, points: as for `sandwich`.
        gradient, state, steps: as for `curvature_by_differences`.
    """
    return sandwich(replace(found, curvature=curvature_by_differences(gradient, state, steps)), points)


def curvature_by_differences(
    gradient: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    state: NDArray[np.float64],
    steps: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Curvature (Q, Q) at a state (Q,) from central differences of the gradient.

    Args:
        gradient: (Q,) sum of the scores at a state, neighbours selected anew.
        steps: (Q,) how far to either side.
    """
    rows = []
    for k, step in enumerate(steps):
        aside = np.zeros(len(state))
        aside[k] = step
        rows.append((gradient(state + aside) - gradient(state - aside)) / (2.0 * step))
    found = np.array(rows)
    return np.asarray(0.5 * (found + found.T))


def sum_by_object(scores: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The scores (N, Q) summed over the cells that their points (N, 2) m lie in: one row (C, Q) per cell."""
    if len(points) == 0:
        return np.zeros((0, scores.shape[1]))
    cells = np.floor((points - points.min(axis=0)) / CLUSTER_M).astype(np.int64)
    _, members = np.unique(cells[:, 0] * (int(cells[:, 1].max()) + 1) + cells[:, 1], return_inverse=True)
    sums = np.zeros((int(members.max()) + 1, scores.shape[1]))
    np.add.at(sums, members, scores)
    return sums
