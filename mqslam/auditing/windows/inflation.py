"""Measures the inflation of a window: how far its map is from the best map of the same points.

psi of two places cannot be compared, so every window is compared with its own best map. A constant twist is added to the
trajectory's motion through the window, and psi is minimised over the twist. The inflation is the square of the best twist in
units of its covariance. If the trajectory is right, this square has a chi-square distribution (three
degrees of freedom).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.sweeps import Sweeps
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.psi.covariance import (
    curvature_by_differences,
    estimate_covariance,
    find_weak_directions,
    floor_variances,
    spread_along,
)
from mqslam.psi.minimiser import (
    BETA_T,
    Minimum,
    Prior,
    Rendered,
    Search,
    annealed_scale,
    final_scale,
    kernel_of,
    minimise,
)
from mqslam.psi.place import PointSet
from mqslam.psi.score import Kernel, PsiEvaluation, Scale, evaluate

# The first search for a window's best map begins with this share of the annealing's first widths. It misses only large
# corrections.
_NARROW_START = 0.4
# If the correction is larger than this share of the first search's widest neighbourhood, the search is repeated with the
# annealing's full widths.
_NARROW_REACH = 0.5
# If the best map matches fewer points than this share of the points that the given map matches, the search is repeated with
# the annealing's full widths.
_LEAST_OVERLAP_KEPT = 0.8
# Movement of a window's ends over which psi's curvature is computed by differences, in units of estimator.beta_s.
_DIFFERENCE_STEP = 0.06
# The search for a window's best map ends with a step that moves the window's ends by less than this, in units of
# estimator.beta_s. No standard deviation is taken to be smaller than this.
_STEP = 2e-3
# Standard deviation of a window's ends, in units of estimator.beta_s, along a direction that the window does not observe.
_UNOBSERVED = 100.0

SWEEP: Final = 1.0  # by definition: duration of a turn of the sensor, where times are counted in sweeps
_LEAST_LEVER_M: Final = 1.0  # numerical: keeps the step in yaw finite where all points lie at the sensor


@dataclass(frozen=True, slots=True)
class Bend:
    """The correction that makes the map of a window its best map.

    Args:
        correction: (3,) twist over the whole window: the motion of the window's end relative to its begin, in the frame of
            the sensor at the middle of the window [m, m, rad].
        covariance: (3, 3) covariance of the correction.
        inflation: correction^T covariance^-1 correction.
        size_m: root mean square distance by which the correction moves the points [m].
        psi, psi_best: score per point without and with the correction.
        matched, matched_best: share of points with a neighbour from another sweep, without and with the correction.
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


@dataclass(frozen=True, slots=True)
class _Window:
    """A window whose map depends on a twist (3,) [m, m, rad per sweep] that is added to the trajectory's motion.

    Args:
        points: N points in the frame of the sensor at the window's middle.
        into: (N,) time from the window's middle to each point, counted in sweeps.
        count: number of sweeps.
        units: (3,) for each component, the twist that moves points at an end of the window by `estimator.beta_s`.
        estimator: settings of the score.
        kernel: settings of the score other than its widths, with times counted in sweeps.
    """

    points: PointSet
    into: NDArray[np.float64]
    count: int
    units: NDArray[np.float64]
    estimator: EstimatorConfig
    kernel: Kernel

    def render(self, twist: NDArray[np.float64]) -> PointSet:
        """Returns the points moved by a twist (3,) per sweep."""
        return twist_points(self.points, self.into, twist)

    def score(self, twist: NDArray[np.float64], scale: Scale) -> PsiEvaluation:
        """Returns the score of the points moved by a twist (3,) per sweep; `scale` gives the widths of the score."""
        return evaluate(self.render(twist), None, scale, self.kernel)

    def minimise(self, share: float) -> Minimum:
        """Finds the twist with the lowest psi; the widths of the annealing begin at a share of their usual first values."""
        start, free, tolerances = np.zeros(3), Prior(np.zeros(3), np.zeros((3, 3))), _STEP * self.units
        return minimise(start, self.render, None, free, self.estimator, self.kernel, tolerances, Search(share=share))

    def bend_at(self, minimum: Minimum, own: PsiEvaluation, weak: NDArray[np.float64]) -> Bend:
        """Returns the correction of the window that a minimum of psi gives.

        Args:
            minimum: minimum of psi over the twist.
            own: score of the map by the trajectory.
            weak: (K, 3) directions of the twist that the window does not observe.
        """
        units, final = self.units, final_scale(self.estimator)
        placed = self.render(minimum.state)
        rendered = Rendered(self.render, None, self.kernel)  # keeps the neighbours from one small difference to the next
        curvature = curvature_by_differences(
            lambda twist: rendered.evaluate(twist, final).gradient, minimum.state, _DIFFERENCE_STEP * units
        )
        evaluation = replace(minimum.evaluation, curvature=curvature)
        covariance = estimate_covariance(evaluation, placed.points, self.estimator.cluster_m)
        covariance = floor_variances(covariance, _STEP * units) + spread_along(weak, _UNOBSERVED * units)
        moved = placed.points - self.render(np.zeros(3)).points
        return Bend(
            correction=minimum.state * self.count,
            covariance=covariance * self.count**2,
            inflation=float(minimum.state @ np.linalg.solve(covariance, minimum.state)),
            size_m=float(np.sqrt(np.mean(np.sum(moved**2, axis=1)))),
            psi=float(own.shares.mean()),
            psi_best=float(minimum.evaluation.shares.mean()),
            matched=float(own.matched.mean()),
            matched_best=float(minimum.evaluation.matched.mean()),
            points=len(placed),
        )


def fit_bend(sweeps: Sweeps, begin: int, end: int, estimator: EstimatorConfig) -> Bend:
    """Finds the correction that makes the map of a window its best map.

    Args:
        sweeps: points under the trajectory to judge.
        begin: number of the first sweep of the window.
        end: number of the sweep after the window.
        estimator: settings of the score.
    """
    points, into = centre_window(sweeps, begin, end)
    count = end - begin
    lever_m = max(float(np.sqrt(np.mean(points.points**2) * 2.0)), _LEAST_LEVER_M)  # root mean square distance of points
    units = estimator.beta_s / (0.5 * count) * np.array([1.0, 1.0, 1.0 / lever_m])
    window = _Window(points, into, count, units, estimator, count_in_sweeps(estimator, sweeps.revolution_s))
    own = window.score(np.zeros(3), final_scale(estimator))
    weak = find_weak_directions(window.score(np.zeros(3), annealed_scale(estimator, 0, _NARROW_START)), 3)

    def fit(share: float) -> Bend:
        return window.bend_at(window.minimise(share), own, weak)

    best = fit(_NARROW_START)
    if best.psi_best > best.psi:  # the search was too wide and missed a better map near the trajectory
        best = min(best, fit(0.0), key=_psi_best)
    overlap_lost = best.matched_best < _LEAST_OVERLAP_KEPT * best.matched
    widest_m = annealed_scale(estimator, 0, _NARROW_START).s
    if overlap_lost or best.size_m > _NARROW_REACH * widest_m:  # beyond the reach of the narrow search
        best = min(best, fit(1.0), key=_psi_best)
    return best


def _psi_best(bend: Bend) -> float:
    return bend.psi_best


def centre_window(sweeps: Sweeps, begin: int, end: int) -> tuple[PointSet, NDArray[np.float64]]:
    """Returns the N points of a window in the frame of the sensor at the window's middle, and their times (N,).

    The window consists of the sweeps begin <= k < end. The times count sweeps from the middle of the window.
    """
    points = sweeps.local(range(begin, end), sweeps.poses[(begin + end) // 2])
    return points, points.times - 0.5 * (sweeps.numbers[begin] + sweeps.numbers[end - 1] + 1.0)


def twist_points(points: PointSet, into: NDArray[np.float64], twist: NDArray[np.float64]) -> PointSet:
    """Returns N points moved by a twist (3,) [m, m, rad per sweep], with their derivatives by the twist.

    Each point moves for the time `into` (N,) from the window's middle to the point, counted in sweeps.
    """
    angle = twist[2] * into
    c, s = np.cos(angle), np.sin(angle)
    x, y = points.points.T
    rotated = np.column_stack([c * x - s * y, s * x + c * y])
    jacobians = np.zeros((len(points), 2, 3))
    jacobians[:, 0, 0] = jacobians[:, 1, 1] = into
    jacobians[:, 0, 2], jacobians[:, 1, 2] = -rotated[:, 1] * into, rotated[:, 0] * into
    return PointSet(rotated + into[:, None] * twist[:2], jacobians, points.covariances, points.times)


def count_in_sweeps(config: EstimatorConfig, revolution_s: float) -> Kernel:
    """Returns the kernel of the score for times in sweeps instead of seconds; a sweep takes `revolution_s` [s]."""
    return kernel_of(config, SWEEP)._replace(beta_t=BETA_T / revolution_s)
