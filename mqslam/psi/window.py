"""Motion of one window from psi alone: the window is rendered, compared with itself, and its motion minimised.

Source: the exhaustive search and the minimum as measurement are the paper's; the annealed minimiser and the covariance
are ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam import se2
from mqslam.motion import CONSTANT_TWIST, MotionModel
from mqslam.psi.covariance import sandwich
from mqslam.psi.estimator import Evaluation, evaluate
from mqslam.psi.minimiser import EstimatorConfig, Minimum, Prior, minimise
from mqslam.psi.neighbours import candidates, cell_grid
from mqslam.psi.place import Beam, PointSet, place
from mqslam.returns import Returns

TOLERANCES = {0: 5e-3, 1: 5e-3, 2: 1e-4}  # step that ends the search, by twist component [m/s, m/s, rad/s]


@dataclass(frozen=True, slots=True)
class WindowMotion:
    """Motion of a window.

    Args:
        theta: (P,) parameters of the motion model.
        covariance: (P, P) of the parameters.
        minimum: where the minimiser ended.
    """

    theta: se2.Array
    covariance: NDArray[np.float64]
    minimum: Minimum


def beam_of(config: EstimatorConfig, doppler_beta: float) -> Beam:
    """The sensor's errors as the settings state them."""
    return Beam(config.sigma_range_m, config.sigma_azimuth, doppler_beta)


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
    covariance = sandwich(found.evaluation, render(found.state).points)
    return WindowMotion(found.state, covariance, found)


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
    scale = config.scale(0)
    lists = candidates(cell_grid(points.points, scale.s), points.points, scale.s)
    return evaluate(
        points, points, lists, scale, revolution_s, config.beta_t, config.xi, config.blur_m, moving_references=True
    )
