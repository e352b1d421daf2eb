"""Where a map lies on the Earth: the rigid motion that lays a trajectory on its fixes, most of which are right."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.statistics import SIGMAS_PER_DEVIATION

_ROUNDS: Final = 50  # of fit and weights, which settle in fewer
_SETTLED: Final = 1e-9  # numerical: a motion that changes by less has settled [m, rad]
_LEAST_M: Final = 1e-6  # numerical: residuals of zero have a scale, too


def align(points: NDArray[np.float64], fixes: NDArray[np.float64]) -> se2.Array:
    """Finds the pose (3,) of a map in the tangent plane, by least squares with weights that leave jumps out.

    The scale of the weights is the median residual, so that up to half of the fixes may be wrong (Geman-McClure).

    Args:
        points: (N, 2) m, where the trajectory has the antenna at the times of the fixes, in the map.
        fixes: (N, 2) m, the fixes in the tangent plane.
    """
    weights, pose = np.ones(len(points)), np.zeros(3)
    for _ in range(_ROUNDS):
        before, pose = pose, _fit(points, fixes, weights)
        squares = np.sum((fixes - se2.transform(pose, points)) ** 2, axis=1)
        scale = SIGMAS_PER_DEVIATION**2 * float(np.median(squares)) + _LEAST_M**2
        weights = (scale / (scale + squares)) ** 2
        if np.abs(se2.subtract(pose, before)).max() < _SETTLED:
            break
    return pose


def measure_stretch(points: NDArray[np.float64], fixes: NDArray[np.float64]) -> float | None:
    """Measures how many times as far apart fixes lie as a trajectory has them.

    Args:
        points: (N, 2) m, where the trajectory has the antenna, as for `align`.
        fixes: (N, 2) m, likewise.

    Returns:
        the median over pairs of fixes that are far apart; None where such a scale does not halve the median residual.
    """
    lags = [len(points) // share for share in (2, 4, 8) if len(points) // share > 0]
    own, given = (
        np.concatenate([np.hypot(*(places[lag:] - places[:-lag]).T) for lag in lags]) if lags else np.empty(0)
        for places in (points, fixes)
    )
    far = own > 0.5 * own.max(initial=0.0)
    if not far.any():
        return None
    stretch = float(np.median(given[far] / own[far]))
    as_it_is, stretched = (measure_residual(scale * points, fixes) for scale in (1.0, stretch))
    return stretch if stretched < 0.5 * as_it_is else None


def is_mirrored(points: NDArray[np.float64], fixes: NDArray[np.float64]) -> bool:
    """Returns whether the mirror image of a trajectory fits fixes far better than it does itself.

    Args:
        points: (N, 2) m, where the trajectory has the antenna, as for `align`.
        fixes: (N, 2) m, likewise.
    """
    as_it_is, mirrored = (measure_residual(points * [1.0, side], fixes) for side in (1.0, -1.0))
    return mirrored < 0.5 * as_it_is


def measure_residual(points: NDArray[np.float64], fixes: NDArray[np.float64]) -> float:
    """Measures the median distance [m] between fixes (N, 2) and a trajectory's points (N, 2) that are laid on them."""
    return float(np.median(np.hypot(*(fixes - se2.transform(align(points, fixes), points)).T)))


def _fit(points: NDArray[np.float64], fixes: NDArray[np.float64], weights: NDArray[np.float64]) -> se2.Array:
    """Returns the rigid motion (3,) that is the weighted least-squares fit (Umeyama, 1991, without scale)."""
    a, b = (np.average(values, axis=0, weights=weights) for values in (points, fixes))
    p, q = points - a, (fixes - b) * weights[:, None]
    yaw = np.arctan2(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]), np.sum(p * q))
    return np.append(b - se2.transform([0.0, 0.0, yaw], a[None])[0], yaw)
