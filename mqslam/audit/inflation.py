"""Inflation: how far a window's map is from its own best, in units of the covariance of that best.

psi of one place does not compare with psi of another, so every window is its own reference: a constant twist is laid over
the trajectory's motion through the window, psi is minimised over it, and the twist found, normalised by its covariance,
is a chi-square with three degrees of freedom where the trajectory is right.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.audit.sweeps import Sweeps
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.psi.covariance import estimate_covariance_by_differences
from mqslam.psi.estimator import Evaluation, Scale
from mqslam.psi.gaussians import floor_variances
from mqslam.psi.minimiser import Minimum, Prior, annealed_scale, final_scale, minimise, score_itself
from mqslam.psi.observability import find_weak_directions, loosen
from mqslam.psi.place import PointSet

_SWEEP = 1.0  # turns between what one direction saw and saw again
_NARROW = 0.4  # first look: this share of the annealing's widths, which finds all but large bends
_ENDS = 2e-3  # step, at the window's ends, that ends the search [beta_s]
_FEW = 0.8  # a best map that matches fewer points than this share of what the trajectory's does is none
_ANYWHERE = 100.0  # standard deviation, at the window's ends, along what the window does not show [beta_s]
_DIFFERENCE = 0.06  # step, at the window's ends, of the differences that give the curvature [beta_s]


@dataclass(frozen=True, slots=True)
class Bend:
    """What would mend a window.

    Args:
        correction: (3,) the twist found, over the whole window: what its end is to be moved against its begin, in the frame
            of its middle [m, m, rad].
        covariance: (3, 3) of it.
        inflation: correction^T covariance^-1 correction.
        size_m: root mean square of how far the correction moves the points [m].
        psi, psi_best: score per point as the trajectory has it and with the correction.
        matched, matched_best: share of points with a neighbour from another sweep.
        points: number of points.
    """

    correction: se2.Array
    covariance: NDArray[np.float64]
    inflation: float
    size_m: float
    psi: float
    psi_best: float
    matched: float
    matched_best: float
    points: int


def bend(sweeps: Sweeps, begin: int, end: int, config: EstimatorConfig) -> Bend:
    """Judge the window of the sweeps begin <= k < end against its own best.

    Args:
        sweeps: points under the trajectory to judge.
        config: settings of the score; lengths of time are counted in sweeps.
    """
    estimator = in_sweeps(config, sweeps.revolution_s)
    final, narrow = final_scale(estimator), _narrowed(estimator, _NARROW)
    count = end - begin
    points, into = middled(sweeps, begin, end)
    reach = max(float(np.sqrt(np.mean(points.points**2) * 2.0)), 1.0)  # root mean square distance from the middle
    units = estimator.beta_s / (0.5 * count) * np.array([1.0, 1.0, 1.0 / reach])  # moves a point at an end by beta_s

    def bent(twist: NDArray[np.float64]) -> PointSet:
        return twisted(points, into, twist)

    def scored(twist: NDArray[np.float64], scale: Scale = final) -> Evaluation:
        return score_itself(bent(twist), scale, _SWEEP, estimator)

    own = scored(np.zeros(3))
    weak = find_weak_directions(scored(np.zeros(3), annealed_scale(narrow, 0)), 3, estimator.observed_share)
    free = Prior(np.zeros(3), np.zeros((3, 3)))

    def minimum(widths: EstimatorConfig) -> Minimum:
        return minimise(np.zeros(3), bent, None, free, widths, _SWEEP, _ENDS * units)

    def judged(widths: EstimatorConfig) -> Bend:
        return _judged(minimum(widths), own, weak, bent, scored, units, count, estimator.cluster_m)

    best = judged(narrow)
    if best.psi_best > best.psi:  # the look was too wide, and led away from where the trajectory is better
        best = min(best, judged(_narrowed(estimator, 0.0)), key=_psi_best)
    if best.matched_best < _FEW * best.matched or best.size_m > 0.5 * narrow.s_start:  # beyond the narrow look's reach
        best = min(best, judged(estimator), key=_psi_best)
    return best


def _narrowed(estimator: EstimatorConfig, share: float) -> EstimatorConfig:
    """The settings with the annealing begun at a share of its widths, but not below the final ones."""
    names = ("s_start", "beta_s_start", "c_start")
    widths = {name: max(share * getattr(estimator, name), getattr(estimator, name.removesuffix("_start"))) for name in names}
    return estimator.model_copy(update=widths)


def _psi_best(found: Bend) -> float:
    return found.psi_best


def _judged(
    found: Minimum,
    own: Evaluation,
    weak: NDArray[np.float64],
    bent: Callable[[NDArray[np.float64]], PointSet],
    scored: Callable[[NDArray[np.float64]], Evaluation],
    units: NDArray[np.float64],
    count: int,
    cluster_m: float,
) -> Bend:
    """The bend that a minimum means."""
    placed = bent(found.state)
    covariance = estimate_covariance_by_differences(
        found.evaluation, placed.points, cluster_m, lambda twist: scored(twist).gradient, found.state, _DIFFERENCE * units
    )
    covariance = loosen(floor_variances(covariance, _ENDS * units), weak, _ANYWHERE * units)
    moved = placed.points - bent(np.zeros(3)).points
    return Bend(
        correction=found.state * count,
        covariance=covariance * count**2,
        inflation=float(found.state @ np.linalg.solve(covariance, found.state)),
        size_m=float(np.sqrt(np.mean(np.sum(moved**2, axis=1)))),
        psi=float(own.shares.mean()),
        psi_best=float(found.evaluation.shares.mean()),
        matched=float(own.matched.mean()),
        matched_best=float(found.evaluation.matched.mean()),
        points=len(placed),
    )


def middled(sweeps: Sweeps, begin: int, end: int) -> tuple[PointSet, NDArray[np.float64]]:
    """A window's points in the frame of the sensor at its middle, and the sweeps (N,) from the middle to each point."""
    points = sweeps.local(range(begin, end), sweeps.poses[(begin + end) // 2])
    return points, points.times - 0.5 * (sweeps.numbers[begin] + sweeps.numbers[end - 1] + 1.0)


def twisted(points: PointSet, into: NDArray[np.float64], twist: NDArray[np.float64]) -> PointSet:
    """Points moved by a twist (3,) per sweep times the sweeps (N,) into it, with derivatives by the twist."""
    angle = twist[2] * into
    c, s = np.cos(angle), np.sin(angle)
    x, y = points.points.T
    turned = np.column_stack([c * x - s * y, s * x + c * y])
    jacobians = np.zeros((len(points), 2, 3))
    jacobians[:, 0, 0] = jacobians[:, 1, 1] = into
    jacobians[:, 0, 2], jacobians[:, 1, 2] = -turned[:, 1] * into, turned[:, 0] * into
    return PointSet(turned + into[:, None] * twist[:2], jacobians, points.covariances, points.times)


def in_sweeps(config: EstimatorConfig, revolution_s: float) -> EstimatorConfig:
    """The settings with times counted in sweeps."""
    return config.model_copy(update={"beta_t": config.beta_t / revolution_s})
