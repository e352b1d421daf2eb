"""The motion of the first scans of a recording, or of those behind a gap, from themselves alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig, TrackerConfig
from mqslam.core import se2
from mqslam.core.measurement import Status
from mqslam.core.motion import CONSTANT_TWIST
from mqslam.core.scans import Returns, Scan
from mqslam.psi.gaussians import invert
from mqslam.psi.minimiser import Minimum
from mqslam.psi.place import Beam
from mqslam.psi.tracking.dynamics import MODEL, SIZE, TOLERANCES, motion_noise
from mqslam.psi.window import WindowMotion, estimate_window, search_twist

START_SCANS = 3  # scans that start a track together
LEAST_MATCHED = 2 * SIZE  # returns that must lie on the map for a match: fewer coordinates than that fit by chance,
LEAST_SHARE = 0.15  # and least share of the scan's returns: below it nothing overlaps
_REACH = 1.0 / 13.0  # share of the annealing's widest reach that it surely bridges per scan
_YAW_STEP = 0.025  # turn per scan [rad] between the yaw rates that are tried
_REST = np.array([5.0, 0.5, 0.1, 4.0, 0.6])  # spread of motions (m/s, m/s, rad/s, m/s^2, rad/s^2) when nothing is known


@dataclass(frozen=True, slots=True)
class FirstMotion:
    """The motion of a few scans.

    Args:
        motion: (5,) twist and accelerations at the first of them; zero in directions that psi does not observe.
        covariance: (5, 5) of them; large in those directions. Where accelerations were not estimated,
            the motion may have changed by the process noise of a scan.
        matched: share of the returns that another scan saw too.
        observed: whether psi observes every direction.
    """

    motion: se2.Array
    covariance: NDArray[np.float64]
    matched: float
    observed: bool


def find_first_motion(
    scans: Sequence[Scan],
    revolution_s: float,
    estimator: EstimatorConfig,
    beam: Beam,
    settings: TrackerConfig,
    begin: se2.Array | None = None,
    odometry: se2.Array | None = None,
) -> FirstMotion:
    """The motion that makes two or three scans crispest.

    Args:
        scans: two or three scans with returns.
        revolution_s: duration of a turn [s].
        estimator, beam: settings of the score, and the sensor's errors.
        settings: bounds of the exhaustive search, and process noise.
        begin: (3,) twist near the truth, or None for an exhaustive search.
        odometry: (3,) what odometry says, for directions that psi alone does not observe.
    """
    t0 = scans[0].t0
    if begin is None:
        two = Returns.concatenate([scan.returns for scan in scans[:2]])
        begin = _search(two, t0, revolution_s, estimator, beam, settings)
    model = MODEL if len(scans) > 2 else CONSTANT_TWIST
    returns = Returns.concatenate([scan.returns for scan in scans])
    found = estimate_window(returns, t0, revolution_s, estimator, beam, begin, model)
    if odometry is not None and found.status is not Status.CONVERGED:
        found = estimate_window(returns, t0, revolution_s, estimator, beam, odometry, model)
    if not overlaps(found.minimum):
        return _know_nothing(settings)
    theta = found.theta
    if odometry is None and found.status is not Status.CONVERGED:
        theta = _without_unobserved(found)
    motion, covariance = np.zeros(MODEL.size), np.zeros((MODEL.size, MODEL.size))
    motion[: model.size] = theta
    covariance[: model.size, : model.size] = found.covariance
    if model.size < MODEL.size:
        covariance += np.diag(motion_noise(settings) ** 2)
    return FirstMotion(motion, covariance, matched_share(found.minimum), found.status is Status.CONVERGED)


def overlaps(found: Minimum) -> bool:
    """Whether a scan lies on the map at all."""
    matched = int(np.count_nonzero(found.evaluation.matched))
    return matched >= LEAST_MATCHED and matched_share(found) >= LEAST_SHARE


def _know_nothing(settings: TrackerConfig) -> FirstMotion:
    """At rest, give or take any motion of a vehicle: what scans that have nothing in common say."""
    fastest = max(settings.speed_max, -settings.speed_min)
    spread = np.array([fastest, fastest, settings.omega_max, settings.sigma_ax, settings.sigma_alpha])
    return FirstMotion(np.zeros(MODEL.size), np.diag(spread**2), 0.0, observed=False)


def matched_share(found: Minimum) -> float:
    """Share of a scan's returns that found a neighbour in the map."""
    matched = found.evaluation.matched
    return float(matched.mean()) if len(matched) else 0.0


def _without_unobserved(found: WindowMotion) -> se2.Array:
    """The parameters shrunk towards rest as far as their covariance leaves them open."""
    size = len(found.theta)
    known = np.diag(_REST[:size] ** 2)
    return np.asarray(known @ invert(known + found.covariance, TOLERANCES[3 : 3 + size]) @ found.theta)


def _search(
    returns: Returns,
    t0: float,
    revolution_s: float,
    estimator: EstimatorConfig,
    beam: Beam,
    settings: TrackerConfig,
) -> se2.Array:
    """The twist (3,) of two scans by exhaustive search over speed and yaw rate."""
    reach_m = estimator.s_start * _REACH
    speeds = np.arange(settings.speed_min, settings.speed_max + 1e-9, reach_m / revolution_s)
    limit = min(settings.omega_max, 1.0 / revolution_s)
    count = int(np.ceil(limit / (_YAW_STEP / revolution_s)))
    yaw_rates = np.linspace(-limit, limit, 2 * count + 1)
    strong = returns.take(returns.intensities >= np.median(returns.intensities))
    twist, _ = search_twist(strong, t0, revolution_s, estimator, beam, speeds, yaw_rates)
    return twist
