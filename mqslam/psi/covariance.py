"""Covariance of the minimum of psi from its curvature.

psi is a sum over points, so its minimiser is an M-estimator and curvature alone has no scale: with H the curvature that
knows of re-selection, and g_c the summed score of the returns of one object (a square cell of the map),

    Sigma = H^-1 (sum_c g_c g_c^T + P^-1) H^-1,

P being the prior's covariance, where there is a prior.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.psi.estimator import Evaluation
from mqslam.psi.minimiser import EstimatorConfig

CLUSTER_M = 2.0


def sandwich(
    found: Evaluation,
    points: NDArray[np.float64],
    prior_information: NDArray[np.float64],
    config: EstimatorConfig,
) -> NDArray[np.float64]:
    """Covariance (Q, Q) of the state at a minimum.

    Args:
        found: the evaluation at the minimum.
        points: (N, 2) m, where the returns lie, to tell which belong to one object.
        prior_information: (Q, Q), zero without a prior.
        config: settings the minimum was found with.
    """
    size = len(prior_information)
    curvature = (found.curvature + config.stabiliser * found.information) / config.correlation + prior_information
    spread = clustered(found.scores, points) / config.correlation**2 + prior_information
    # a direction that nothing holds must come out uncertain, not singular
    floor = np.diag(1e-9 + 1e-9 * np.diag(found.information))
    inverse = np.linalg.pinv(_positive(curvature) + floor, hermitian=True)
    covariance = inverse @ (spread + floor) @ inverse
    return np.asarray(0.5 * (covariance + covariance.T)).reshape(size, size)


def clustered(scores: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """sum_c g_c g_c^T (Q, Q) of scores (N, Q) summed over the cells their points (N, 2) m lie in."""
    if len(points) == 0:
        return np.zeros((scores.shape[1], scores.shape[1]))
    cells = np.floor((points - points.min(axis=0)) / CLUSTER_M).astype(np.int64)
    _, members = np.unique(cells[:, 0] * (int(cells[:, 1].max()) + 1) + cells[:, 1], return_inverse=True)
    sums = np.zeros((int(members.max()) + 1, scores.shape[1]))
    np.add.at(sums, members, scores)
    return np.asarray(sums.T @ sums)


def _positive(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The symmetric matrix with its negative eigenvalues set to zero."""
    units = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(matrix)), 1e-12))
    values, vectors = np.linalg.eigh(matrix * units[:, None] * units[None, :])
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T / units[:, None] / units[None, :])
