"""Motion of one window from psi alone: the window is rendered, compared with itself, and its motion minimised.

Source: the exhaustive search and the minimum as measurement are the paper's; the annealed minimiser and the covariance
are ours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.measurement import Status
from mqslam.core.motion import CONSTANT_TWIST, MotionModel
from mqslam.core.scans import Returns
from mqslam.psi.covariance import sandwich_by_differences
from mqslam.psi.estimator import Evaluation
from mqslam.psi.gaussians import floor_variances, invert
from mqslam.psi.minimiser import Minimum, Prior, annealed_scale, final_scale, minimise, score_itself
from mqslam.psi.observability import loosen, weak_directions
from mqslam.psi.place import Beam, PointSet, place

SPANS = {0: 20.0, 1: 20.0, 2: 1.0}  # standard deviation of a component nothing is known of [m/s, m/s, rad/s]
_STARTS = 3  # basins of the exhaustive search that are refined
_DIFFERENT = 25.0  # squared distance, in units of the covariances, beyond which two motions are not the same
AS_GOOD = 1.25  # psi of a rival, over the best, up to which the window cannot tell them apart
_DIFFERENCE = 4.0  # step of the differences that give the curvature [tolerances]
TOLERANCES = {0: 5e-3, 1: 5e-3, 2: 1e-4}  # step that ends the search, by twist component [m/s, m/s, rad/s]


@dataclass(frozen=True, slots=True)
class WindowMotion:
    """Motion of a window.

    Args:
        theta: (P,) parameters of the motion model.
        covariance: (P, P) of the parameters.
        minimum: where the minimiser ended.
        status: converged; degenerate, where a direction is not observed and the covariance is large along it; ambiguous,
            where another motion explains the window about as well.
    """

    theta: se2.Array
    covariance: NDArray[np.float64]
    minimum: Minimum
    status: Status


def estimate_window(
    returns: Returns,
    t0: float,
    revolution_s: float,
    config: EstimatorConfig,
    beam: Beam,
    start: se2.Array,
    model: MotionModel = CONSTANT_TWIST,
) -> WindowMotion:
    """The motion that makes a window's map crispest, from a start within the annealing's reach.

    Args:
        returns: two revolutions of returns at least.
        t0: start of the window [s].
        revolution_s: duration of a turn [s].
        config: settings of the estimator.
        beam: the sensor's errors.
        start: (3,) constant twist to begin at [m/s, m/s, rad/s].
        model: motion model of the window.
    """
    tolerances = np.array([TOLERANCES[component] for component in model.components])
    free = Prior(np.zeros(model.size), np.zeros((model.size, model.size)))

    def render(theta: NDArray[np.float64]) -> PointSet:
        return without_start(place(returns, t0, np.zeros(3), theta, model, beam))

    found = minimise(model.from_twist(start), render, None, free, config, revolution_s, tolerances)
    points = render(found.state)

    def gradient(theta: NDArray[np.float64]) -> NDArray[np.float64]:
        return score_itself(render(theta), final_scale(config), revolution_s, config).gradient

    spread = sandwich_by_differences(found.evaluation, points.points, gradient, found.state, _DIFFERENCE * tolerances)
    covariance = floor_variances(spread, tolerances)
    weak = weak_directions(score_itself(points, annealed_scale(config, 0), revolution_s, config), model.size)
    if len(weak):
        covariance = loosen(covariance, weak, np.array([SPANS[component] for component in model.components]))
    return WindowMotion(found.state, covariance, found, Status.DEGENERATE if len(weak) else Status.CONVERGED)


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
    """The motion of a window without any start: exhaustive search, then the best basins refined.

    Args:
        returns: two revolutions of returns at least.
        speeds, yaw_rates: grid of the search [m/s], [rad/s]; its steps must be within the annealing's reach.
        model: motion model of the window; further arguments as for `estimate_window`.
    """
    two = returns.take(returns.times < t0 + 2.0 * revolution_s)
    _, scores = search_twist(two, t0, revolution_s, config, beam, speeds, yaw_rates)
    starts = [np.array([speeds[i], 0.0, yaw_rates[k]]) for i, k in _basins(scores)[:_STARTS]]
    found = [estimate_window(returns, t0, revolution_s, config, beam, start, model) for start in starts]
    found.sort(key=lambda motion: motion.minimum.evaluation.psi)
    best = found[0]
    tolerances = np.array([TOLERANCES[component] for component in model.components])
    for other in found[1:]:
        apart = other.theta - best.theta
        different = apart @ invert(best.covariance + other.covariance, tolerances) @ apart > _DIFFERENT
        if different and other.minimum.evaluation.psi < AS_GOOD * best.minimum.evaluation.psi:
            return replace(best, status=Status.AMBIGUOUS)
    return best


def _basins(scores: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Cells of a score grid that no neighbour beats, best first."""
    lowest = minimum_filter(scores, size=3, mode="nearest") == scores
    cells = np.argwhere(lowest)
    order = np.argsort(scores[lowest], kind="stable")
    return [(int(i), int(k)) for i, k in cells[order]]


def without_start(points: PointSet) -> PointSet:
    """The same points as functions of the motion parameters only: a window's score does not see its start pose."""
    return PointSet(points.points, np.ascontiguousarray(points.jacobians[:, :, 3:]), points.covariances, points.times)


def search_twist(
    returns: Returns,
    t0: float,
    revolution_s: float,
    config: EstimatorConfig,
    beam: Beam,
    speeds: NDArray[np.float64],
    yaw_rates: NDArray[np.float64],
) -> tuple[se2.Array, NDArray[np.float64]]:
    """Exhaustive search over (v, omega) with the widest score, unmatched returns charged.

    Args:
        returns: two revolutions of returns at least.
        speeds: (V,) m/s to try.
        yaw_rates: (W,) rad/s to try.

    Returns:
        the best twist (3,) and the scores (V, W).
    """
    scores = np.empty((len(speeds), len(yaw_rates)))
    for i, v in enumerate(speeds):
        for k, omega in enumerate(yaw_rates):
            twist = np.array([v, 0.0, omega])
            scores[i, k] = window_score(returns, t0, revolution_s, config, beam, twist).psi
    best = np.unravel_index(np.argmin(scores), scores.shape)
    return np.array([speeds[best[0]], 0.0, yaw_rates[best[1]]]), scores


def window_score(
    returns: Returns, t0: float, revolution_s: float, config: EstimatorConfig, beam: Beam, twist: se2.Array
) -> Evaluation:
    """The estimator's score of a window under a constant twist (3,), at the widest scale."""
    placed = place(returns, t0, np.zeros(3), twist, CONSTANT_TWIST, beam)
    points = PointSet(placed.points, np.empty((len(returns), 2, 0)), placed.covariances, placed.times)
    return score_itself(points, annealed_scale(config, 0), revolution_s, config)
