"""The tracker's state and how it moves on from one revolution to the next.

State of a revolution, eight numbers: start pose x [m], y [m], yaw [rad] in the tracker's frame; twist at the start vx
[m/s], vy [m/s], omega [rad/s] in the body frame; accelerations ax [m/s^2] and alpha [rad/s^2], constant while it lasts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.config import TrackerConfig
from mqslam.core import se2
from mqslam.core.motion import ACCELERATED_TWIST
from mqslam.psi.minimiser import Prior

MODEL = ACCELERATED_TWIST
SIZE = 3 + MODEL.size
TOLERANCES = np.array([1e-3, 1e-3, 2e-5, 5e-3, 5e-3, 1e-4, 2e-2, 1e-3])  # steps that end a search, by state variable
_NOISE_PERIOD_S = 0.25  # process noise is stated per revolution of this length


def initial_covariance(settings: TrackerConfig) -> NDArray[np.float64]:
    """(8, 8) of a state whose pose defines the frame and whose twist a window has found."""
    unsure = [settings.sigma_vx, settings.sigma_vy, settings.sigma_omega, settings.sigma_ax, settings.sigma_alpha]
    return np.diag(np.r_[1e-8, 1e-8, 1e-12, np.square(unsure)])


def predict(
    state: se2.Array, covariance: NDArray[np.float64], dt: float, longest: float, settings: TrackerConfig
) -> tuple[se2.Array, NDArray[np.float64]]:
    """State and covariance a time dt [s] later.

    Args:
        longest: beyond this time [s] acceleration is not extrapolated: nobody brakes for that long.
        settings: process noise.
    """
    theta = state[3:].copy()
    if dt > longest:
        theta[3:] = 0.0
    step, by_theta = MODEL.pose(theta, dt)
    pose = se2.compose(state[:3], step)
    c, s = np.cos(state[2]), np.sin(state[2])
    persistence = settings.persistence ** (dt / _NOISE_PERIOD_S)
    transition = np.eye(SIZE)
    transition[:3, 3:] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ by_theta
    transition[:2, 2] = state[1] - pose[1], pose[0] - state[0]
    transition[3, 6] = transition[5, 7] = dt
    transition[6, 6] = transition[7, 7] = persistence
    if dt > longest:
        transition[:6, 6:] = 0.0
    after = np.r_[pose, theta[0] + dt * theta[3], theta[1], theta[2] + dt * theta[4], persistence * theta[3:]]
    noise = np.array([
        settings.sigma_position_m, settings.sigma_position_m, settings.sigma_yaw,
        settings.sigma_vx, settings.sigma_vy, settings.sigma_omega, settings.sigma_ax, settings.sigma_alpha,
    ])  # fmt: skip
    grown = transition @ covariance @ transition.T + np.diag(noise**2) * (dt / _NOISE_PERIOD_S)
    return after, 0.5 * (grown + grown.T)


def held(prior: Prior, weak: NDArray[np.float64]) -> Prior:
    """The prior made stiff along directions (K, 3) that psi does not observe: for the pose and for the twist."""
    c, s = np.cos(prior.mean[2]), np.sin(prior.mean[2])
    to_body = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    information = prior.information.copy()
    for direction in weak:
        for block, along in ((slice(0, 3), direction), (slice(3, 6), to_body @ direction)):
            units = TOLERANCES[block]
            unit = along / units / np.linalg.norm(along / units) / units
            information[block, block] += np.outer(unit, unit)
    return Prior(prior.mean, information)


def spans(settings: TrackerConfig, revolution_s: float) -> NDArray[np.float64]:
    """(3,) how far a start pose may be off when nothing is known of it [m, m, rad]."""
    travel = 0.5 * max(settings.speed_max, -settings.speed_min) * revolution_s
    return np.array([travel, travel, settings.omega_max * revolution_s])
