"""Estimates the motion of one window from psi alone: the window is rendered and compared with itself, and psi is minimised.

"The widest scale" means the widths of the score at the start of the annealing (see `mqslam.psi.minimiser`).

Source: "Motion Estimation from Map Quality with Millimeter Wave Radar" for the exhaustive search and for the minimum as the
measurement. The annealed minimiser and the covariance are ours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.measurement import Status
from mqslam.core.motion import CONSTANT_TWIST, OMEGA, MotionModel
from mqslam.core.scans import Returns
from mqslam.psi.covariance import (
    curvature_by_differences,
    estimate_covariance,
    find_weak_directions,
    floor_variances,
    invert,
    spread_along,
)
from mqslam.psi.minimiser import Minimum, Prior, annealed_scale, final_scale, minimise
from mqslam.psi.neighbours import find_candidates, sort_into_cells
from mqslam.psi.place import Beam, PointArrays, PointSet, place, place_arrays
from mqslam.psi.score import Kernel, PsiEvaluation, Scale, evaluate, evaluate_each_other

# Number of basins of a window's exhaustive search that are refined, the best ones first.
_BASINS = 3
# Step of the finite differences that give the curvature of a window's score, in units of the step that ends the search.
_DIFFERENCE_STEP = 4.0
# Standard deviation of a window's speed [m/s] and of its yaw rate [rad/s] in a direction that psi does not observe.
_UNKNOWN_SPEED, _UNKNOWN_YAW_RATE = 20.0, 1.0
# Step that ends the search, by twist component [m/s, m/s, rad/s]: a numerical tolerance, far below the errors of a motion.
_TOLERANCES = {0: 5e-3, 1: 5e-3, 2: 1e-4}
_LINE = 3  # a search first scores every third row and column of its grid; with every fourth it missed some best motions

# The best motion counts as ambiguous if psi of a different motion is less than this factor times psi of the best motion.
RIVAL = 1.25
# Squared distance between two motions of a window, in units of their covariances, beyond which they are different motions.
_DIFFERENT = 25.0


@dataclass(frozen=True, slots=True)
class WindowMotion:
    """The estimated motion of a window.

    Args:
        theta: (P,) parameters of the motion model, such as speeds [m/s] and a yaw rate [rad/s].
        covariance: (P, P) covariance of the parameters.
        minimum: result of the minimiser.
        status: ambiguous if `Window.find` found a different motion with about as low a psi; else degenerate if psi does not
            observe a direction, along which the covariance is then large; else converged.
    """

    theta: se2.Array
    covariance: NDArray[np.float64]
    minimum: Minimum
    status: Status


@dataclass(frozen=True, slots=True)
class Window:
    """Returns of several scans that are rendered under one motion and compared with each other.

    Args:
        returns: returns of two or more scans.
        t0: start of the window [s since the recording's start].
        kernel: parameters of the score besides its widths.
        config: widths of the score and of its annealing.
        beam: the sensor's errors.
    """

    returns: Returns
    t0: float
    kernel: Kernel
    config: EstimatorConfig
    beam: Beam

    def render(self, theta: se2.Array, model: MotionModel = CONSTANT_TWIST) -> PointSet:
        """Renders the window under parameters (P,) of a motion model, in the frame of the sensor at the window's start.

        The points have no rays, and no derivatives by the start pose, on which the score does not depend.
        """
        points = place(self.returns, self.t0, np.zeros(3), theta, model, self.beam)
        return PointSet(points.points, np.ascontiguousarray(points.jacobians[:, :, 3:]), points.covariances, points.times)

    def score(self, theta: se2.Array, model: MotionModel, scale: Scale) -> PsiEvaluation:
        """Returns psi and its derivatives under parameters (P,) of a motion model, at the given widths."""
        return evaluate(self.render(theta, model), None, scale, self.kernel)

    def score_twists(self, twists: se2.Array) -> NDArray[np.float64]:
        """Returns psi (T,) at the widest scale under each of T constant twists (T, 3): vx, vy [m/s], omega [rad/s]."""
        if len(self.returns) == 0:
            return np.zeros(len(twists))
        returns, scale = self.returns, annealed_scale(self.config, 0)
        measured = returns.ranges, returns.azimuths, returns.times - self.t0
        return np.asarray(_list_shares(*measured, twists, CONSTANT_TWIST.arrays, self.beam, scale, self.kernel).sum(axis=1))

    def score_grid(self, speeds: NDArray[np.float64], yaw_rates: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns psi (V, W) at the widest scale for each pair of a forward speed (V,) [m/s] and a yaw rate (W,) [rad/s]."""
        still = np.zeros(len(yaw_rates))
        rows = [self.score_twists(np.column_stack([still + speed, still, yaw_rates])) for speed in speeds]
        return np.array(rows)

    def search(self, speeds: NDArray[np.float64], yaw_rates: NDArray[np.float64]) -> se2.Array:
        """Finds the twist of a grid with the lowest psi at the widest scale, although only a part of the grid is scored.

        At the widest scale psi varies slowly, so that pairs of every third speed and every third yaw rate show about where
        psi is lowest. All other pairs are scored only around the best three of these.

        Args:
            speeds: (V,) forward speeds to try [m/s].
            yaw_rates: (W,) yaw rates to try [rad/s].

        Returns:
            The twist (3,): vx [m/s], vy = 0, omega [rad/s].
        """
        scores = np.full((len(speeds), len(yaw_rates)), np.inf)

        def score_at(marked: NDArray[np.bool_]) -> NDArray[np.intp]:
            cells = np.argwhere(marked)
            v, w = cells.T
            scores[v, w] = self.score_twists(np.column_stack([speeds[v], np.zeros(len(cells)), yaw_rates[w]]))
            return cells

        marked = np.zeros(scores.shape, dtype=np.bool_)
        marked[_LINE // 2 :: _LINE, _LINE // 2 :: _LINE] = True
        crossings = score_at(marked)
        marked[:] = False
        for v, w in crossings[np.argsort(scores[tuple(crossings.T)], kind="stable")[:_BASINS]]:
            marked[max(v - _LINE + 1, 0) : v + _LINE, max(w - _LINE + 1, 0) : w + _LINE] = True
        score_at(marked & ~np.isfinite(scores))
        v, w = np.unravel_index(np.argmin(scores), scores.shape)
        return np.array([speeds[v], 0.0, yaw_rates[w]])

    def estimate(self, start: se2.Array, model: MotionModel = CONSTANT_TWIST) -> WindowMotion:
        """Estimates the motion that makes the map crispest, beginning at a twist (3,): vx, vy [m/s], omega [rad/s].

        The widest scale must cover the error of this twist.
        """
        config, tolerances = self.config, _list_tolerances(model)
        free = Prior(np.zeros(model.size), np.zeros((model.size, model.size)))
        minimum = minimise(
            model.from_twist(start), lambda theta: self.render(theta, model), None, free, config, self.kernel, tolerances
        )
        curvature = curvature_by_differences(
            lambda theta: self.score(theta, model, final_scale(config)).gradient,
            minimum.state,
            _DIFFERENCE_STEP * tolerances,
        )
        points, sharp = self.render(minimum.state, model), replace(minimum.evaluation, curvature=curvature)
        covariance = floor_variances(estimate_covariance(sharp, points.points, config.cluster_m), tolerances)
        weak = find_weak_directions(evaluate(points, None, annealed_scale(config, 0), self.kernel), model.size)
        if len(weak):
            unknown = [_UNKNOWN_YAW_RATE if c == OMEGA else _UNKNOWN_SPEED for c in model.components]
            covariance = covariance + spread_along(weak, np.array(unknown))
        return WindowMotion(minimum.state, covariance, minimum, Status.DEGENERATE if len(weak) else Status.CONVERGED)

    def find(
        self, speeds: NDArray[np.float64], yaw_rates: NDArray[np.float64], model: MotionModel = CONSTANT_TWIST
    ) -> WindowMotion:
        """Finds the motion without an initial guess: searches a grid with the first two scans, then refines the best basins.

        The result is the refined motion with the lowest psi.

        Args:
            speeds: (V,) forward speeds of the grid [m/s], in steps that the widest scale covers.
            yaw_rates: (W,) yaw rates of the grid [rad/s], in steps that the widest scale covers.
            model: motion model of the window.
        """
        two = self.returns.take(self.returns.times < self.t0 + 2.0 * self.kernel.revolution_s)
        scores = replace(self, returns=two).score_grid(speeds, yaw_rates)
        starts = [np.array([speeds[i], 0.0, yaw_rates[k]]) for i, k in _find_basins(scores)[:_BASINS]]
        best, *others = sorted(
            (self.estimate(start, model) for start in starts), key=lambda motion: motion.minimum.evaluation.psi
        )
        for other in others:
            apart = other.theta - best.theta
            distance = apart @ invert(best.covariance + other.covariance, _list_tolerances(model)) @ apart
            if distance > _DIFFERENT and other.minimum.evaluation.psi < RIVAL * best.minimum.evaluation.psi:
                return replace(best, status=Status.AMBIGUOUS)
        return best


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _list_shares(
    ranges: NDArray[np.float64],
    azimuths: NDArray[np.float64],
    times: NDArray[np.float64],
    twists: NDArray[np.float64],
    model: tuple[NDArray[np.int64], NDArray[np.int64]],
    beam: Beam,
    scale: Scale,
    kernel: Kernel,
) -> NDArray[np.float64]:
    """Returns the share of psi (T, N) of each return under each motion; `twists` (T, P) are parameters of the model.

    The returns are ranges (N,) [m], azimuths (N,) [rad] and times (N,) [s since the window's start].
    """
    shares = np.empty((len(twists), len(ranges)))
    no_jacobians, no_rays = np.empty((len(ranges), 2, 0)), np.empty((0, 2))
    for k in range(len(twists)):
        points, _, covariances, _ = place_arrays(ranges, azimuths, times, np.zeros(3), twists[k], model, beam)
        lists = find_candidates(sort_into_cells(points, scale.s), points, scale.s)
        arrays = PointArrays(points, no_jacobians, covariances, times, no_rays)
        shares[k] = evaluate_each_other(arrays, lists, scale, kernel)[0]
    return shares


def _list_tolerances(model: MotionModel) -> NDArray[np.float64]:
    """Returns for each parameter (P,) of a motion model, in its unit, the step below which the search ends."""
    return np.array([_TOLERANCES[component] for component in model.components])


def _find_basins(scores: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Returns the indices [v, w] of each local minimum of a grid of scores (V, W), the lowest minimum first."""
    lowest = minimum_filter(scores, size=3, mode="nearest") == scores
    cells = np.argwhere(lowest)
    order = np.argsort(scores[lowest], kind="stable")
    return [(int(i), int(k)) for i, k in cells[order]]
