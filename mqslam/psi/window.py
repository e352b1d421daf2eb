"""Motion of one window from psi alone: the window is rendered and compared with itself, and psi is minimised.

Source: the exhaustive search and the minimum as the measurement are the paper's; the annealed minimiser and the
covariance are ours.
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
from mqslam.psi.minimiser import Minimum, Prior, annealed_scale, final_scale, kernel_of, minimise
from mqslam.psi.neighbours import find_candidates, sort_into_cells
from mqslam.psi.place import Beam, PointArrays, PointSet, place, place_arrays
from mqslam.psi.score import Kernel, Scale, evaluate, evaluate_each_other


def score_twists(
    returns: Returns, t0: float, twists: se2.Array, beam: Beam, scale: Scale, kernel: Kernel
) -> NDArray[np.float64]:
    """Returns psi (T,) of a window under each of many constant twists, compared with itself whatever the views are.

    Args:
        returns: of the window.
        t0: its start [s].
        twists: (T, 3) m/s, m/s, rad/s.
        beam: the sensor's errors.
        scale: widths of selection and weights.
        kernel: the score besides its widths.
    """
    if len(returns) == 0:
        return np.zeros(len(twists))
    measured = returns.ranges, returns.azimuths, returns.times - t0
    return np.asarray(_list_shares(*measured, twists, CONSTANT_TWIST.arrays, beam, scale, kernel).sum(axis=1))


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
    """Returns the shares of psi (T, N) of the points under each twist."""
    shares = np.empty((len(twists), len(ranges)))
    no_jacobians, no_rays = np.empty((len(ranges), 2, 0)), np.empty((0, 2))
    for k in range(len(twists)):
        points, _, covariances, _ = place_arrays(ranges, azimuths, times, np.zeros(3), twists[k], model, beam)
        lists = find_candidates(sort_into_cells(points, scale.s), points, scale.s)
        arrays = PointArrays(points, no_jacobians, covariances, times, no_rays)
        shares[k] = evaluate_each_other(arrays, lists, scale, kernel)[0]
    return shares


# Number of basins of a window's exhaustive search that are refined, the best ones first.
_BASINS = 3
# Step of the differences that give the curvature of a window's score, in units of the step that ends the search.
_DIFFERENCE_STEP = 4.0
# Standard deviation of a window's speed in a direction that psi does not observe [m/s].
_UNKNOWN_SPEED = 20.0
# Standard deviation of a window's yaw rate where psi does not observe it [rad/s].
_UNKNOWN_YAW_RATE = 1.0

TOLERANCES = {0: 5e-3, 1: 5e-3, 2: 1e-4}
"""Step that ends the search, by twist component [m/s, m/s, rad/s]: a numerical tolerance, far below psi's own noise."""
_LINE = 3  # every how many steps a search over a grid of twists has a line at first; with 4 it missed the best one at times

# A motion counts as ambiguous where another one has a psi below this factor times the best one's.
RIVAL = 1.25
# Squared distance between two motions of a window, in units of their covariances, beyond which they are different motions.
_DIFFERENT = 25.0


@dataclass(frozen=True, slots=True)
class WindowMotion:
    """The motion of a window.

    Args:
        theta: (P,) parameters of the motion model.
        covariance: (P, P) of the parameters.
        minimum: where the minimiser ended.
        status: degenerate where a direction is not observed and the covariance is large along it, ambiguous where
            another motion explains the window about as well, and converged otherwise.
    """

    theta: se2.Array
    covariance: NDArray[np.float64]
    minimum: Minimum
    status: Status


def estimate_window(
    returns: Returns,
    t0: float,
    kernel: Kernel,
    config: EstimatorConfig,
    beam: Beam,
    start: se2.Array,
    model: MotionModel = CONSTANT_TWIST,
) -> WindowMotion:
    """Estimates the motion that makes a window's map crispest, from a start within the annealing's reach.

    Args:
        returns: of two scans at least.
        t0: start of the window [s].
        kernel: the score besides its widths.
        config: settings of the estimator.
        beam: the sensor's errors.
        start: (3,) constant twist at which the search begins [m/s, m/s, rad/s].
        model: motion model of the window.
    """
    tolerances = _tolerances(model)
    free = Prior(np.zeros(model.size), np.zeros((model.size, model.size)))

    def render(theta: NDArray[np.float64]) -> PointSet:
        return drop_start(place(returns, t0, np.zeros(3), theta, model, beam))

    minimum = minimise(model.from_twist(start), render, None, free, config, kernel, tolerances)
    points = render(minimum.state)

    def gradient(theta: NDArray[np.float64]) -> NDArray[np.float64]:
        return evaluate(render(theta), None, final_scale(config), kernel).gradient

    curvature = curvature_by_differences(gradient, minimum.state, _DIFFERENCE_STEP * tolerances)
    sharp = replace(minimum.evaluation, curvature=curvature)
    covariance = floor_variances(estimate_covariance(sharp, points.points, config.cluster_m), tolerances)
    wide = evaluate(points, None, annealed_scale(config, 0), kernel)
    weak = find_weak_directions(wide, model.size)
    if len(weak):
        unknown = [_UNKNOWN_YAW_RATE if c == OMEGA else _UNKNOWN_SPEED for c in model.components]
        covariance = covariance + spread_along(weak, np.array(unknown))
    return WindowMotion(minimum.state, covariance, minimum, Status.DEGENERATE if len(weak) else Status.CONVERGED)


def _tolerances(model: MotionModel) -> NDArray[np.float64]:
    """Returns the steps (P,) that end the search over a model's parameters."""
    return np.array([TOLERANCES[component] for component in model.components])


def find_window_motion(
    returns: Returns,
    t0: float,
    revolution_s: float,
    config: EstimatorConfig,
    beam: Beam,
    speeds: NDArray[np.float64],
    yaw_rates: NDArray[np.float64],
    model: MotionModel = CONSTANT_TWIST,
) -> WindowMotion:
    """Finds the motion of a window without any start: searches exhaustively, then refines the best basins.

    Args:
        returns: of two scans at least.
        t0: start of the window [s].
        revolution_s: duration of a turn [s].
        config: settings of the estimator.
        beam: the sensor's errors.
        speeds: (V,) m/s that the search tries, in steps within the annealing's reach.
        yaw_rates: (W,) rad/s that the search tries, in steps within the annealing's reach.
        model: motion model of the window.
    """
    two = returns.take(returns.times < t0 + 2.0 * revolution_s)
    kernel = kernel_of(config, revolution_s)
    scores = score_all_twists(two, t0, kernel, config, beam, speeds, yaw_rates)
    starts = [np.array([speeds[i], 0.0, yaw_rates[k]]) for i, k in _find_basins(scores)[:_BASINS]]
    motions = [estimate_window(returns, t0, kernel, config, beam, start, model) for start in starts]
    motions.sort(key=lambda motion: motion.minimum.evaluation.psi)
    best = motions[0]
    for other in motions[1:]:
        apart = other.theta - best.theta
        different = apart @ invert(best.covariance + other.covariance, _tolerances(model)) @ apart > _DIFFERENT
        if different and other.minimum.evaluation.psi < RIVAL * best.minimum.evaluation.psi:
            return replace(best, status=Status.AMBIGUOUS)
    return best


def _find_basins(scores: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Finds the cells of a grid of scores that no neighbour beats, the best first."""
    lowest = minimum_filter(scores, size=3, mode="nearest") == scores
    cells = np.argwhere(lowest)
    order = np.argsort(scores[lowest], kind="stable")
    return [(int(i), int(k)) for i, k in cells[order]]


def drop_start(points: PointSet) -> PointSet:
    """Drops the derivatives by the start pose: the score of a window that is compared with itself does not depend on it."""
    return PointSet(points.points, np.ascontiguousarray(points.jacobians[:, :, 3:]), points.covariances, points.times)


def search_twist(
    returns: Returns,
    t0: float,
    kernel: Kernel,
    config: EstimatorConfig,
    beam: Beam,
    speeds: NDArray[np.float64],
    yaw_rates: NDArray[np.float64],
) -> se2.Array:
    """Finds the best (v, omega) of a grid by the widest score, as `score_all_twists` does, but scores few of them.

    The score is so wide that its lowest place shows on every third line of the grid. What lies between these lines is scored
    around the best few of their crossings only.

    Args:
        returns: of two scans at least.
        t0: start of the window [s].
        kernel: the score besides its widths.
        config: settings of the estimator.
        beam: the sensor's errors.
        speeds: (V,) m/s to try.
        yaw_rates: (W,) rad/s to try.

    Returns:
        The best twist (3,).
    """
    scale = annealed_scale(config, 0)
    scores = np.full((len(speeds), len(yaw_rates)), np.inf)

    def score_at(cells: NDArray[np.intp]) -> None:
        v, w = cells.T
        twists = np.column_stack([speeds[v], np.zeros(len(cells)), yaw_rates[w]])
        scores[v, w] = score_twists(returns, t0, twists, beam, scale, kernel)

    crossings = np.argwhere(_mark_crossings(scores.shape))
    score_at(crossings)
    best = crossings[np.argsort(scores[tuple(crossings.T)], kind="stable")[:_BASINS]]
    score_at(np.argwhere(_mark_around(best, scores.shape) & ~np.isfinite(scores)))
    v, w = np.unravel_index(np.argmin(scores), scores.shape)
    return np.array([speeds[v], 0.0, yaw_rates[w]])


def _mark_crossings(shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Marks where every third line of a grid crosses another one."""
    marked = np.zeros(shape, dtype=np.bool_)
    marked[_LINE // 2 :: _LINE, _LINE // 2 :: _LINE] = True
    return marked


def _mark_around(cells: NDArray[np.intp], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Marks the cells (C, 2) of a grid and all up to the next lines around them."""
    marked = np.zeros(shape, dtype=np.bool_)
    for v, w in cells:
        marked[max(v - _LINE + 1, 0) : v + _LINE, max(w - _LINE + 1, 0) : w + _LINE] = True
    return marked


def score_all_twists(
    returns: Returns,
    t0: float,
    kernel: Kernel,
    config: EstimatorConfig,
    beam: Beam,
    speeds: NDArray[np.float64],
    yaw_rates: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Returns the widest score (V, W), which charges unmatched returns, of every (v, omega) of a grid.

    Args:
        returns: of two scans at least.
        t0: start of the window [s].
        kernel: the score besides its widths.
        config: settings of the estimator.
        beam: the sensor's errors.
        speeds: (V,) m/s.
        yaw_rates: (W,) rad/s.
    """
    scale = annealed_scale(config, 0)
    scores = np.empty((len(speeds), len(yaw_rates)))
    for i, v in enumerate(speeds):
        twists = np.column_stack([np.full(len(yaw_rates), v), np.zeros(len(yaw_rates)), yaw_rates])
        scores[i] = score_twists(returns, t0, twists, beam, scale, kernel)
    return scores
