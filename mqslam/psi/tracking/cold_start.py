"""Finds the motion of the first scans of a recording, or of the scans after a gap, from these scans alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.measurement import Status
from mqslam.core.motion import CONSTANT_TWIST
from mqslam.core.scans import Returns, Scan
from mqslam.psi.covariance import invert
from mqslam.psi.tracking.matching import Matcher
from mqslam.psi.tracking.plausibility import overlaps
from mqslam.psi.tracking.state import (
    MODEL,
    MOTION,
    OMEGA_MAX,
    SIGMA_AX,
    SPEED_MIN,
    START_ALPHA,
    TOLERANCES,
    list_motion_noise,
)
from mqslam.psi.window import Window

# Number of scans from which a track finds its first motion: three scans show an acceleration, too.
START_SCANS = 3
# The step between the speeds that are tried is the score's first width s_start per revolution of the radar, divided by this
# number. The minimiser then surely finds the minimum from the nearest of these speeds.
_START_SPEEDS = 13.0
# Step between the yaw rates that are tried, and the largest rotation that the motion model integrates exactly, both per scan
# [rad].
_START_YAW_STEP, _MOST_TURN = 0.025, 1.0
# Standard deviations around rest of vx, vy [m/s], omega [rad/s], ax [m/s^2], alpha [rad/s^2] that psi does not observe.
_AT_REST = np.array([5.0, 0.5, 0.1, SIGMA_AX, START_ALPHA])


@dataclass(frozen=True, slots=True)
class FirstMotion:
    """The motion of a few scans: found from these scans alone or, if odometry guides the tracker, odometry's motion.

    Args:
        motion: (5,) vx, vy [m/s], omega [rad/s], ax [m/s^2], alpha [rad/s^2] at the first scan. In directions that psi does
            not observe, the motion is near odometry's if odometry was given, else near zero; zero without overlap.
        covariance: (5, 5) covariance of the motion, large in directions that psi does not observe. It includes process
            noise if only two scans were given, since the accelerations are then not estimated.
        matched: share of the returns that have a selected neighbour: 0 if scans do not overlap, 1 for odometry's motion.
        observed: whether psi observes every direction of the motion; True for odometry's motion.
    """

    motion: se2.Array
    covariance: NDArray[np.float64]
    matched: float
    observed: bool


def find_first_motion(
    scans: Sequence[Scan], matcher: Matcher, begin: se2.Array | None = None, odometry: se2.Array | None = None
) -> FirstMotion:
    """Finds the motion that gives the crispest map of a few scans.

    Args:
        scans: two or three scans with returns. Two scans do not show accelerations, which are then zero.
        matcher: holds the bounds of the exhaustive search, the process noise, the settings of the score, and the sensor.
        begin: (3,) vx, vy [m/s], omega [rad/s] near the truth, at which the minimiser starts; None searches exhaustively.
        odometry: (3,) vx, vy [m/s], omega [rad/s] by odometry, at which the minimiser starts again if psi does not observe
            every direction; None without odometry.
    """
    if begin is None:
        begin = _search_twist(scans, matcher)
    model = MODEL if len(scans) > 2 else CONSTANT_TWIST  # two scans do not show an acceleration
    size, returns = model.size, Returns.concatenate([scan.returns for scan in scans])
    window = Window(returns, scans[0].t0, matcher.kernel, matcher.estimator, matcher.beam)
    found = window.estimate(begin, model)
    if odometry is not None and found.status is not Status.CONVERGED:
        found = window.estimate(odometry, model)
    if not overlaps(found.minimum):  # scans without overlap show no motion: any motion of a vehicle is possible
        fastest = max(matcher.settings.speed_max, -SPEED_MIN)
        spread = np.array([fastest, fastest, OMEGA_MAX, SIGMA_AX, START_ALPHA])
        return FirstMotion(np.zeros(MODEL.size), np.diag(spread**2), 0.0, observed=False)
    theta = found.theta
    if odometry is None and found.status is not Status.CONVERGED:
        # where psi leaves the motion open, it is shrunk towards rest
        at_rest = np.diag(_AT_REST[:size] ** 2)
        theta = at_rest @ invert(at_rest + found.covariance, TOLERANCES[MOTION][:size]) @ theta
    motion, covariance = np.zeros(MODEL.size), np.zeros((MODEL.size, MODEL.size))
    motion[:size], covariance[:size, :size] = theta, found.covariance
    if size < MODEL.size:
        covariance += np.diag(list_motion_noise(matcher.young) ** 2)
    return FirstMotion(motion, covariance, found.minimum.evaluation.overlap, found.status is Status.CONVERGED)


def _search_twist(scans: Sequence[Scan], matcher: Matcher) -> se2.Array:
    """Searches speeds and yaw rates for the twist (3,) of the first two scans: vx, vy = 0 [m/s], omega [rad/s].

    Only the stronger half of the returns is used.
    """
    revolution_s, (slowest, fastest) = matcher.revolution_s, matcher.speeds
    returns = Returns.concatenate([scan.returns for scan in scans[:2]])
    strong = returns.take(returns.intensities >= np.median(returns.intensities))
    step_m = matcher.estimator.s_start / _START_SPEEDS
    speeds = np.arange(slowest, fastest + 1e-9, step_m / revolution_s)
    limit = min(OMEGA_MAX, _MOST_TURN / revolution_s)
    count = int(np.ceil(limit / (_START_YAW_STEP / revolution_s)))
    yaw_rates = np.linspace(-limit, limit, 2 * count + 1)
    return Window(strong, scans[0].t0, matcher.kernel, matcher.estimator, matcher.beam).search(speeds, yaw_rates)
