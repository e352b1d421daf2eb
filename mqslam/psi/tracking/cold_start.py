"""The motion of the first scans of a recording, or of those after a gap, from themselves alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.measurement import Status
from mqslam.core.motion import CONSTANT_TWIST
from mqslam.core.scans import Returns, Scan
from mqslam.psi.gaussians import invert
from mqslam.psi.tracking.dynamics import OMEGA_MAX, SIGMA_AX, list_motion_noise
from mqslam.psi.tracking.plausibility import measure_overlap, overlaps
from mqslam.psi.tracking.setup import SPEED_MIN, START_ALPHA, Setup
from mqslam.psi.tracking.state import MODEL, MOTION, TOLERANCES
from mqslam.psi.window import WindowMotion, estimate_window, search_twist

# The cold start tries speeds in steps of the annealing's widest reach per turn, divided by this, so that the minimiser
# surely finds the minimum from the nearest of them.
_START_SPEEDS = 13.0
# Turn per scan between the yaw rates that a start tries [rad].
_START_YAW_STEP = 0.025
# Spread of forward speeds around rest, in directions that psi does not observe at a start [m/s].
_REST_SPEED = 5.0
# Spread of sideways speeds around rest, in directions that psi does not observe at a start [m/s].
_REST_SLIP = 0.5
# Spread of yaw rates around rest, in directions that psi does not observe at a start [rad/s].
_REST_OMEGA = 0.1

_MOST_TURN = 1.0  # turn per scan [rad] up to which the motion model is integrated exactly; faster ones are not tried


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

    @property
    def twist(self) -> se2.Array:
        """(3,) twist at the first of the scans [m/s, m/s, rad/s]."""
        return self.motion[: CONSTANT_TWIST.size]


def find_first_motion(
    scans: Sequence[Scan], setup: Setup, begin: se2.Array | None = None, odometry: se2.Array | None = None
) -> FirstMotion:
    """Finds the motion that makes a few scans crispest.

    Args:
        scans: two or three scans with returns.
        setup: bounds of the exhaustive search, process noise, settings of the score, and the sensor.
        begin: (3,) twist near the truth, or None for an exhaustive search.
        odometry: (3,) odometry's twist, for directions that psi alone does not observe.
    """
    if begin is None:
        begin = _search_twist(scans, setup)
    model = MODEL if len(scans) > 2 else CONSTANT_TWIST  # two scans do not show an acceleration
    returns = Returns.concatenate([scan.returns for scan in scans])

    def estimate(start: se2.Array) -> WindowMotion:
        return estimate_window(returns, scans[0].t0, setup.kernel, setup.estimator, setup.beam, start, model)

    window = estimate(begin)
    if odometry is not None and window.status is not Status.CONVERGED:
        window = estimate(odometry)
    if not overlaps(window.minimum):
        return _know_nothing(setup.settings.speed_max)
    theta = window.theta
    if odometry is None and window.status is not Status.CONVERGED:
        theta = _shrink_unobserved(window)
    motion, covariance = np.zeros(MODEL.size), np.zeros((MODEL.size, MODEL.size))
    motion[: model.size] = theta
    covariance[: model.size, : model.size] = window.covariance
    if model.size < MODEL.size:
        covariance += np.diag(list_motion_noise(setup.young) ** 2)
    return FirstMotion(motion, covariance, measure_overlap(window.minimum), window.status is Status.CONVERGED)


def _know_nothing(speed_max: float) -> FirstMotion:
    """Returns rest, with the uncertainty of any motion of a vehicle: scans that have nothing in common show no more."""
    fastest = max(speed_max, -SPEED_MIN)
    spread = np.array([fastest, fastest, OMEGA_MAX, SIGMA_AX, START_ALPHA])
    return FirstMotion(np.zeros(MODEL.size), np.diag(spread**2), 0.0, observed=False)


def _shrink_unobserved(estimate: WindowMotion) -> se2.Array:
    """Shrinks the motion's parameters towards rest as far as their covariance leaves them open."""
    size = len(estimate.theta)
    at_rest = np.array([_REST_SPEED, _REST_SLIP, _REST_OMEGA, SIGMA_AX, START_ALPHA])
    known = np.diag(at_rest[:size] ** 2)
    return np.asarray(known @ invert(known + estimate.covariance, TOLERANCES[MOTION][:size]) @ estimate.theta)


def _search_twist(scans: Sequence[Scan], setup: Setup) -> se2.Array:
    """Finds the twist (3,) of the first two scans by exhaustive search over speed and yaw rate."""
    revolution_s, (slowest, fastest) = setup.revolution_s, setup.speeds
    returns = Returns.concatenate([scan.returns for scan in scans[:2]])
    strong = returns.take(returns.intensities >= np.median(returns.intensities))
    step_m = setup.estimator.s_start / _START_SPEEDS
    speeds = np.arange(slowest, fastest + 1e-9, step_m / revolution_s)
    limit = min(OMEGA_MAX, _MOST_TURN / revolution_s)
    count = int(np.ceil(limit / (_START_YAW_STEP / revolution_s)))
    yaw_rates = np.linspace(-limit, limit, 2 * count + 1)
    return search_twist(strong, scans[0].t0, setup.kernel, setup.estimator, setup.beam, speeds, yaw_rates)
