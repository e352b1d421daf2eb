"""Computes the uncertainty of a minimum of psi: its covariance and the directions that psi does not observe.

psi is a sum over points, so its minimum is an M-estimate, and the curvature alone does not give the scale of a
covariance. Let H be `PsiEvaluation.curvature`, and g_c the sum of `PsiEvaluation.scores` over the returns of one object (a
square cell of the map). The covariance is then

    Sigma = n / (n - q) H^-1 (sum_c g_c g_c^T) H^-1        for n objects and q variables.

A direction is a vector of changes of the state's variables, such as a shift along a wall. In a direction that psi hardly
observes, H is hardly positive, and Sigma comes out large. The factor n / (n - q) is the usual correction for few samples: q
variables can bring the scores of q objects to zero, whatever their errors are.

Along a bare wall the returns of two views are scattered alike at any shift. At wide widths of the score (a wide scale), H
therefore vanishes along the wall, whereas at a narrow scale single returns pair up by chance and look like a minimum. The
ratio of H to Gauss-Newton's curvature at the widest scale shows whether psi observes a direction: 0.22 and more where there
are windows, poles and corners, 0.12 and less along a bare corridor.

Metres, radians and their rates differ by orders of magnitude, so every matrix is brought to comparable units before it is
factorised. An eigenvalue below the rounding error is raised to that error. Covariances have the units of the state.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mqslam.psi.score import PsiEvaluation

# These two numbers tune nothing: the first stands for "unknown", the second keeps the inverse of the curvature finite.
_UNKNOWN = 1e6  # variance, in units of the inverse information, where there are no more objects than variables
_LEAST = 1e-3  # ratio of H to Gauss-Newton's curvature below which a direction counts as not observed at all

# A sum of differences is significant if it is larger than this many of its standard deviations: a usual level (95 %).
_SIGNIFICANT = 1.0
# If the ratio of H to Gauss-Newton's curvature is less than this at the widest scale, a direction counts as not observed.
_OBSERVED_SHARE = 0.16
_SHOWN = 1e-9  # eigenvalues of the normalised information below this share of the largest one are rounding errors
_ROUNDING = 1e-12  # eigenvalues below this share of the largest one are rounding errors


def estimate_covariance(
    evaluation: PsiEvaluation, points: NDArray[np.float64], cluster_m: float, known: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Returns the covariance (Q, Q) of the state at a minimum: Sigma of the module's docstring.

    `known` is added to H and to the matrix between the two inverses. Only returns with a selected neighbour count. If there
    are no more objects than variables, all variances are very large, whatever `known` says.

    Args:
        evaluation: the score at the minimum.
        points: (N, 2) positions of the returns [m], by which returns are grouped into objects.
        cluster_m: side of the cells [m] within which returns belong to one object.
        known: (Q, Q) information about the state from sources other than psi, times the number of returns that count as one
            measurement, because the curvature counts every return; None if there is no such information.
    """
    if known is None:
        known = np.zeros_like(evaluation.curvature)
    units = 1.0 / np.sqrt(np.maximum(np.diag(evaluation.information + known), 1e-12))
    scale = np.outer(units, units)
    sums = sum_by_object(evaluation.scores[evaluation.matched], points[evaluation.matched], cluster_m)
    objects, variables = sums.shape
    if objects <= variables:
        return np.diag(_UNKNOWN * units**2)
    values, vectors = np.linalg.eigh((evaluation.curvature + known) * scale)
    spread = vectors.T @ ((sums.T @ sums * (objects / (objects - variables)) + known) * scale) @ vectors
    inverse = 1.0 / np.maximum(values, _LEAST)
    # along a direction that psi does not observe, the variance is at least the inverse of the least curvature
    spread += np.diag(np.where(values < _LEAST, 1.0, 0.0) * _LEAST)
    return symmetric((vectors * inverse) @ spread @ (vectors * inverse).T * scale)


def sum_by_object(scores: NDArray[np.float64], points: NDArray[np.float64], cluster_m: float) -> NDArray[np.float64]:
    """Returns the sum (C, Q) of the scores (N, Q) of the points (N, 2) [m] in each of the C square cells that hold points.

    A cell has sides of length `cluster_m` [m].
    """
    if len(points) == 0:
        return np.zeros((0, scores.shape[1]))
    cells = np.floor((points - points.min(axis=0)) / cluster_m).astype(np.int64)
    _, members = np.unique(cells[:, 0] * (int(cells[:, 1].max()) + 1) + cells[:, 1], return_inverse=True)
    return np.column_stack([np.bincount(members, weights=column) for column in scores.T])


def are_worse(
    differences: NDArray[np.float64], points: NDArray[np.float64], cluster_m: float, sigmas: float
) -> NDArray[np.bool_]:
    """Returns for each of K states whether its score is significantly larger than the score at a minimum (Vuong, 1989).

    The differences between the points' scores are summed by object, as in the covariance. If both states fit equally well,
    the sum over all objects is about zero, compared with its standard deviation.

    Args:
        differences: (K, N) score of each point at each state, minus its score at the minimum.
        points: (N, 2) positions of the points [m], by which they are grouped into objects.
        cluster_m: side of the cells [m] within which points belong to one object.
        sigmas: a sum of more than this many standard deviations is significant.
    """
    sums = sum_by_object(differences.T, points, cluster_m)
    return np.asarray(sums.sum(axis=0) > sigmas * np.sqrt(np.sum(sums**2, axis=0)))


def find_sigma_by_profile(
    offsets: NDArray[np.float64], differences: NDArray[np.float64], points: NDArray[np.float64], cluster_m: float
) -> float:
    """Estimates a variable's standard deviation from how fast the score rises around a minimum.

    Where single points pair up by chance, a score has many narrow minima, and the curvature of one of them does not show how
    far the others lie. With H and g_c as in the module's docstring, a smooth score rises by H d^2 at a distance d from its
    minimum, and this rise has the standard deviation 2 d sqrt(sum_c g_c^2). The variable's own standard deviation is
    sigma = sqrt(sum_c g_c^2) / H. The rise therefore exceeds k of its standard deviations where d > 2 k sigma. The result is
    the largest distance at which it does not, divided by 2 k (k is `_SIGNIFICANT`); zero if it does at all distances.

    Args:
        offsets: (K,) distances from the minimum, in the unit of the variable.
        differences: (K, N) score of each point at each distance, minus its score at the minimum.
        points: (N, 2) positions of the points [m], by which they are grouped into objects.
        cluster_m: side of the cells [m] within which points belong to one object.
    """
    worse = are_worse(differences, points, cluster_m, _SIGNIFICANT)
    return float(np.abs(offsets[~worse]).max(initial=0.0)) / (2.0 * _SIGNIFICANT)


def curvature_by_differences(
    gradient: Callable[[NDArray[np.float64]], NDArray[np.float64]], state: NDArray[np.float64], steps: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Returns H (Q, Q), half the second derivative of psi, from central differences.

    Where all points move with the state, the curvature that `evaluate` returns is up to four times too large.

    Args:
        gradient: returns `PsiEvaluation.gradient` (Q,) at a state, at which the neighbours are selected anew.
        state: (Q,) state at which the curvature is computed.
        steps: (Q,) step of the differences to either side, in the units of the state.
    """
    rows = [gradient(state + side) - gradient(state - side) for side in np.diag(steps)]
    return symmetric(np.array(rows) / (2.0 * steps[:, None]))


def find_weak_directions(wide: PsiEvaluation, size: int) -> NDArray[np.float64]:
    """Finds the directions (K, size) that psi does not observe; K is 0 if psi observes all directions.

    A direction d is as long as makes d^T G d equal to 1, where G is Gauss-Newton's information. If G is singular, as it is
    when all returns lie on one ray, no direction counts as observed, and the result is the identity.

    Args:
        wide: an evaluation at the widest scale, near the minimum.
        size: number of state variables in a direction, counted from the first variable of the state.
    """
    information = wide.information[:size, :size]
    units = np.sqrt(np.diag(information))
    if not np.all(units > 0.0):
        return np.eye(size)
    values, vectors = np.linalg.eigh(information / np.outer(units, units))
    if values[0] < _SHOWN * values[-1]:
        return np.eye(size)
    whiten = (vectors / np.sqrt(values)) / units[:, None]
    shares, directions = np.linalg.eigh(whiten.T @ wide.curvature[:size, :size] @ whiten)
    return np.asarray((whiten @ directions[:, shares < _OBSERVED_SHARE]).T)


def spread_along(directions: NDArray[np.float64], spans: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns a covariance (Q, Q) that is large along given directions and zero across them.

    One standard deviation along a direction is the longest change by which no variable changes by more than its span.

    Args:
        directions: (K, Q) directions that psi does not observe; if there are none, the covariance is zero.
        spans: (Q,) standard deviation of each variable when nothing is known about it.
    """
    spread = np.zeros((len(spans), len(spans)))
    for direction in directions:
        length = np.min(spans / np.maximum(np.abs(direction), 1e-12))  # until any variable reaches its span
        spread += np.outer(direction, direction) * length**2
    return spread


def invert(matrix: NDArray[np.float64], units: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the inverse of a symmetric matrix (Q, Q), made symmetric and positive definite.

    Args:
        matrix: a covariance matrix or an information matrix.
        units: (Q,) typical size of each variable for a covariance matrix, one over this size for an information matrix.
            Entries [i, k] divided by units[i] * units[k] are comparable.
    """
    scale = np.outer(units, units)
    values, vectors = _find_positive(matrix, scale)
    return symmetric((vectors / values) @ vectors.T / scale)


def fuse(first: NDArray[np.float64], second: NDArray[np.float64], units: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the covariance (Q, Q) of the fusion of two independent estimates.

    The result (first^-1 + second^-1)^-1 is computed as first (first + second)^-1 second, which also works if one of the two
    matrices is singular.

    Args:
        first: (Q, Q) covariance of one estimate.
        second: (Q, Q) covariance of the other estimate.
        units: (Q,) typical size of each variable.
    """
    scale = np.outer(units, units)
    values, vectors = _find_positive(first @ invert(first + second, units) @ second, scale)
    return symmetric((vectors * values) @ vectors.T * scale)


def _find_positive(
    matrix: NDArray[np.float64], scale: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns the eigenvalues (Q,) and the eigenvectors (Q, Q) of matrix / scale, the quotient of their entries.

    Eigenvalues below the rounding error are raised to the rounding error.
    """
    values, vectors = np.linalg.eigh(symmetric(matrix) / scale)
    return np.maximum(values, max(_ROUNDING * float(values[-1]), np.finfo(np.float64).tiny)), vectors


def floor_variances(covariance: NDArray[np.float64], steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Raises the variances of a covariance (Q, Q) to at least the squares of the steps (Q,) that end a search.

    Scans that are equal to the last digit leave no residual. Without the floor, the result would seem to be known exactly.
    """
    scale = np.outer(steps, steps)
    values, vectors = np.linalg.eigh(symmetric(covariance) / scale)
    if values[0] >= 1.0:
        return covariance
    return symmetric((vectors * np.maximum(values, 1.0)) @ vectors.T * scale)


def symmetric(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the symmetric part of a square matrix, which rounding has made slightly unsymmetric."""
    return np.asarray(0.5 * (matrix + matrix.T))
