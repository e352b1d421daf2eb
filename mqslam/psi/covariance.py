"""Covariance of the minimum of psi from its curvature.

psi is a sum over points, so its minimiser is an M-estimator and its curvature alone has no scale. With H the curvature
that knows of re-selection, and g_c the summed score of the returns of one object (a square cell of the map),

    Sigma = n / (n - q) H^-1 (sum_c g_c g_c^T) H^-1        for n objects and q variables.

In a direction that is hardly observed H is hardly positive, and Sigma comes out large along it. The first factor is the
usual one for few samples: q variables can make the scores of q objects vanish, whatever their errors are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mqslam.psi.scoring.estimator import PsiEvaluation

# Neither number tunes anything: the first stands for "unknown", the second keeps the inverse of the curvature finite.
_UNKNOWN = 1e6  # variance, over that of the curvature alone, where there are no more objects than variables
_LEAST = 1e-3  # share of Gauss-Newton's curvature below which a direction counts as not observed at all


def estimate_covariance(
    evaluation: PsiEvaluation, points: NDArray[np.float64], cluster_m: float, known: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Returns the covariance (Q, Q) of the state at a minimum: a sandwich over clusters of returns.

    Args:
        evaluation: the score at the minimum.
        points: (N, 2) m, where the returns lie, which tells those that belong to one object.
        cluster_m: side of the cells [m] within which returns belong to one object.
        known: (Q, Q) information about the state besides psi, in the curvature's scale.
    """
    if known is None:
        known = np.zeros_like(evaluation.curvature)
    units = 1.0 / np.sqrt(np.maximum(np.diag(evaluation.information + known), 1e-12))
    scale = units[:, None] * units[None, :]
    sums = sum_by_object(evaluation.scores[evaluation.matched], points[evaluation.matched], cluster_m)
    objects, variables = sums.shape
    if objects <= variables:
        return np.diag(_UNKNOWN * units**2)
    values, vectors = np.linalg.eigh((evaluation.curvature + known) * scale)
    spread = vectors.T @ ((sums.T @ sums * (objects / (objects - variables)) + known) * scale) @ vectors
    inverse = 1.0 / np.maximum(values, _LEAST)
    # along a direction that psi does not hold, the variance is at least the inverse of the least curvature
    spread += np.diag(np.where(values < _LEAST, 1.0, 0.0) * _LEAST)
    covariance = (vectors * inverse) @ spread @ (vectors * inverse).T * scale
    return np.asarray(0.5 * (covariance + covariance.T))


def estimate_covariance_by_differences(
    evaluation: PsiEvaluation,
    points: NDArray[np.float64],
    cluster_m: float,
    gradient: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    state: NDArray[np.float64],
    steps: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Returns the covariance (Q, Q) at a minimum where all points move with the state.

    There the evaluation's own curvature is up to four times too large, so differences of the gradient take its place.

    Args:
        evaluation: as for `estimate_covariance`.
        points: as for `estimate_covariance`.
        cluster_m: as for `estimate_covariance`.
        gradient: as for `curvature_by_differences`.
        state: as for `curvature_by_differences`.
        steps: as for `curvature_by_differences`.
    """
    curvature = curvature_by_differences(gradient, state, steps)
    return estimate_covariance(replace(evaluation, curvature=curvature), points, cluster_m)


def curvature_by_differences(
    gradient: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    state: NDArray[np.float64],
    steps: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Returns the curvature (Q, Q) of psi from central differences of its gradient.

    Args:
        gradient: returns the sum (Q,) of the scores at a state, neighbours selected anew.
        state: (Q,) where the curvature is wanted.
        steps: (Q,) how far the differences reach to either side.
    """
    rows = []
    for k, step in enumerate(steps):
        aside = np.zeros(len(state))
        aside[k] = step
        rows.append((gradient(state + aside) - gradient(state - aside)) / (2.0 * step))
    curvature = np.array(rows)
    return np.asarray(0.5 * (curvature + curvature.T))


def sum_by_object(scores: NDArray[np.float64], points: NDArray[np.float64], cluster_m: float) -> NDArray[np.float64]:
    """Sums the scores (N, Q) over the cells of side `cluster_m` that their points (N, 2) m lie in: a row (C, Q) per cell."""
    if len(points) == 0:
        return np.zeros((0, scores.shape[1]))
    cells = np.floor((points - points.min(axis=0)) / cluster_m).astype(np.int64)
    _, members = np.unique(cells[:, 0] * (int(cells[:, 1].max()) + 1) + cells[:, 1], return_inverse=True)
    return np.column_stack([np.bincount(members, weights=column) for column in scores.T])
