"""The relative pose of two submaps by psi: a global search inside a gate, the annealed minimum, its covariance.

The search correlates the two submaps as blurred images at several yaws (the widest, cheapest form of the score); the
best peaks are refined by psi, which has the last word.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.psi.covariance import estimate_covariance
from mqslam.psi.estimator import Evaluation
from mqslam.psi.minimiser import Prior, annealed_scale, final_scale, minimise, score
from mqslam.psi.neighbours import CellGrid, find_candidates, sort_into_cells
from mqslam.psi.observability import find_weak_directions
from mqslam.psi.place import PointSet, rotate_covariances
from mqslam.psi.tracking.correlate import PIXEL, SAME, correlation_peaks

ANY_TIME = 0.0  # turns between neighbours: submaps are compared whatever their times
_TOLERANCES = np.array([1e-3, 1e-3, 2e-5])


@dataclass(frozen=True, slots=True)
class Alignment:
    """Where one submap lies in the other.

    Args:
        pose: (3,) of the query's frame in the reference's.
        covariance: (3, 3) of it [m, m, rad].
        matched: share of the query's points with a neighbour.
        psi: score per point.
        rival: score per point of the best other pose in the gate; infinite if there is none.
        observed: whether the maps hold every direction.
    """

    pose: se2.Array
    covariance: NDArray[np.float64]
    matched: float
    psi: float
    rival: float
    observed: bool


def align(
    reference: PointSet,
    query: PointSet,
    guess: se2.Array,
    reach_m: float,
    reach_rad: float,
    config: EstimatorConfig,
) -> Alignment:
    """The pose of a submap in another's frame.

    Args:
        reference, query: submaps in their own frames.
        guess: (3,) pose of the query's frame in the reference's, right to reach_m [m] and reach_rad [rad].
    """
    grid = sort_into_cells(reference.points, 1.0)
    free = Prior(guess, np.zeros((3, 3)))
    pixel_m = PIXEL * config.s_start
    found = []
    peaks = correlation_peaks(reference.points, query.points, guess, reach_m, reach_rad, pixel_m)
    for start in [guess, *peaks]:  # where the trajectory has it is as good a hypothesis as any
        minimum = minimise(start, lambda pose: moved(query, pose), reference, free, config, ANY_TIME, _TOLERANCES, grid)
        off = se2.between(guess, minimum.state)
        if np.hypot(off[0], off[1]) <= reach_m + 1.0 and abs(off[2]) <= reach_rad + 0.05:
            found.append(minimum)
    if not found:
        return Alignment(guess, np.eye(3), 0.0, np.inf, np.inf, observed=False)
    found.sort(key=lambda minimum: minimum.evaluation.psi)
    best = found[0]
    rivals = [m for m in found[1:] if np.hypot(*(m.state - best.state)[:2]) > SAME * pixel_m]
    points = moved(query, best.state)
    wide = _scored(reference, grid, points, config, wide=True)
    return Alignment(
        pose=best.state,
        covariance=estimate_covariance(best.evaluation, points.points, config.cluster_m),
        matched=float(best.evaluation.matched.mean()),
        psi=best.evaluation.psi / len(query),
        rival=rivals[0].evaluation.psi / len(query) if rivals else np.inf,
        observed=len(find_weak_directions(wide, 3, config.observed_share)) == 0,
    )


def cross_score(reference: PointSet, query: PointSet, pose: se2.Array, config: EstimatorConfig) -> float:
    """Psi per point of the query laid into the reference at a pose (3,)."""
    found = _scored(reference, sort_into_cells(reference.points, 1.0), moved(query, pose), config, wide=False)
    return found.psi / len(query)


def moved(points: PointSet, pose: se2.Array) -> PointSet:
    """A rigid submap at a pose (3,), with derivatives by that pose."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    x, y = points.points.T
    dx, dy = c * x - s * y, s * x + c * y
    jacobians = np.zeros((len(points), 2, 3))
    jacobians[:, 0, 0] = jacobians[:, 1, 1] = 1.0
    jacobians[:, 0, 2], jacobians[:, 1, 2] = -dy, dx
    covariances = rotate_covariances(points.covariances, float(pose[2]))
    return PointSet(np.column_stack([pose[0] + dx, pose[1] + dy]), jacobians, covariances, points.times)


def _scored(reference: PointSet, grid: CellGrid, points: PointSet, config: EstimatorConfig, *, wide: bool) -> Evaluation:
    scale = annealed_scale(config, 0) if wide else final_scale(config)
    lists = find_candidates(grid, points.points, scale.s)
    return score(points, reference, lists, scale, ANY_TIME, config)
