"""The tracker's state and how it moves on from one scan to the next.

A state has eight numbers: the start pose x [m], y [m], yaw [rad] of a scan in the tracker's frame; the twist at its start
vx [m/s], vy [m/s], omega [rad/s] in the body frame; the accelerations ax [m/s^2] and alpha [rad/s^2], which are constant
while the scan lasts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.config import TrackerConfig
from mqslam.core import se2
from mqslam.core.motion import ACCELERATED_TWIST
from mqslam.psi.gaussians import invert, symmetric
from mqslam.psi.minimiser import Prior

MODEL = ACCELERATED_TWIST
SIZE = 3 + MODEL.size
TOLERANCES = np.array([1e-3, 1e-3, 2e-5, 5e-3, 5e-3, 1e-4, 2e-2, 1e-3])  # steps that end a search, by state variable
POSE, TWIST, MOTION, ACCELERATION = slice(0, 3), slice(3, 6), slice(3, SIZE), slice(6, SIZE)
_NOISE_PERIOD_S = 0.25  # process noise is stated per scan of this length
_STEADY_S = 0.75  # an acceleration lasts that long


@dataclass(frozen=True, slots=True)
class State:
    """What is known of the sensor's motion at the start of a scan.

    Args:
        mean: (8,) start pose, twist and accelerations, see the module.
        covariance: (8, 8) of them.
    """

    mean: se2.Array
    covariance: NDArray[np.float64]

    @property
    def pose(self) -> se2.Array:
        """(3,) start pose [m, m, rad]."""
        return self.mean[POSE]

    @property
    def information(self) -> NDArray[np.float64]:
        """(8, 8) inverse of the covariance."""
        return invert(self.covariance, TOLERANCES)

    @property
    def prior(self) -> Prior:
        """The state as the prior of a minimisation."""
        return Prior(self.mean, self.information)


def initial_state(motion: se2.Array, covariance: NDArray[np.float64], settings: TrackerConfig) -> State:
    """A state whose pose defines the frame and whose motion was found without a map.

    Args:
        motion: (5,) twist and accelerations.
        covariance: (5, 5) of them, as far as they were measured.
        settings: process noise, which the motion may have changed by since it was measured.
    """
    spread = np.zeros((SIZE, SIZE))
    spread[POSE, POSE] = np.diag([1e-8, 1e-8, 1e-12])
    spread[MOTION, MOTION] = np.diag(motion_noise(settings) ** 2) + covariance
    return State(np.r_[np.zeros(3), motion], spread)


def predict(state: State, dt: float, settings: TrackerConfig) -> State:
    """The state a time dt [s] later, or earlier where dt is negative, at constant acceleration."""
    theta = state.mean[MOTION]
    step, by_theta = MODEL.pose(theta, dt)
    pose = se2.compose(state.pose, step)
    c, s = np.cos(state.mean[2]), np.sin(state.mean[2])
    persistence = settings.persistence ** (abs(dt) / _NOISE_PERIOD_S)
    transition = np.eye(SIZE)
    transition[POSE, MOTION] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ by_theta
    transition[:2, 2] = state.mean[1] - pose[1], pose[0] - state.mean[0]
    transition[3, 6] = transition[5, 7] = dt
    transition[6, 6] = transition[7, 7] = persistence
    after = np.r_[pose, theta[0] + dt * theta[3], theta[1], theta[2] + dt * theta[4], persistence * theta[3:]]
    pose_noise = [settings.sigma_position_m, settings.sigma_position_m, settings.sigma_yaw]
    noise = np.square(np.r_[pose_noise, motion_noise(settings)]) * (abs(dt) / _NOISE_PERIOD_S)
    return State(after, symmetric(transition @ state.covariance @ transition.T + np.diag(noise)))


def coast(state: State, dt: float, turn_s: float, settings: TrackerConfig) -> State:
    """The state a long time dt [s] later: the twist is followed, and its changes add up turn by turn.

    Nobody brakes for long, so the acceleration is forgotten: it is as unknown at the end as at the start of a recording.

    Args:
        state: at the start.
        dt: how much later, more than a turn.
        turn_s: duration of a turn [s], the step in which changes of the twist are added.
        settings: process noise.
    """
    steps = max(1, round(dt / turn_s))
    state = _forget_acceleration(state, np.zeros(2))
    for _ in range(steps):
        state = _forget_acceleration(predict(state, dt / steps, settings), np.zeros(2))
    return _forget_acceleration(state, np.square(motion_noise(settings)[3:]))


def know_motion(state: State, motion: se2.Array, covariance: NDArray[np.float64]) -> State:
    """The state once its twist and accelerations (5,) were measured with a covariance (5, 5)."""
    gain = state.covariance[:, MOTION] @ invert(state.covariance[MOTION, MOTION] + covariance, TOLERANCES[MOTION])
    kept = np.eye(SIZE)
    kept[:, MOTION] -= gain
    spread = kept @ state.covariance @ kept.T + gain @ covariance @ gain.T
    return State(state.mean + gain @ (motion - state.mean[MOTION]), symmetric(spread))


def take_motion(state: State, motion: se2.Array, covariance: NDArray[np.float64]) -> State:
    """The state with twist and accelerations (5,) of a covariance (5, 5) that say nothing of its pose."""
    spread = np.zeros((SIZE, SIZE))
    spread[POSE, POSE] = state.covariance[POSE, POSE]
    spread[MOTION, MOTION] = covariance
    return State(np.r_[state.pose, motion], spread)


def longest_step(turn_s: float) -> float:
    """Longest time [s] between the starts of scans that follow each other: a scan may be missing, but not many."""
    return max(_STEADY_S, 1.5 * turn_s)


def hold_directions(prior: Prior, weak: NDArray[np.float64]) -> Prior:
    """The prior made stiff along directions (K, 3) that psi does not observe: for pose, twist and acceleration."""
    c, s = np.cos(prior.mean[2]), np.sin(prior.mean[2])
    to_body = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    information = prior.information.copy()
    for direction in weak:
        body = to_body @ direction
        for block, along in ((POSE, direction), (TWIST, body), (ACCELERATION, body[[0, 2]])):
            units = TOLERANCES[block]
            length = float(np.linalg.norm(along / units))
            if length > 0.0:
                unit = along / units / length / units
                information[block, block] += np.outer(unit, unit)
    return Prior(prior.mean, information)


def spans(settings: TrackerConfig, revolution_s: float) -> NDArray[np.float64]:
    """(3,) how far a start pose may be off when nothing is known of it [m, m, rad]."""
    travel = 0.5 * max(settings.speed_max, -settings.speed_min) * revolution_s
    return np.array([travel, travel, settings.omega_max * revolution_s])


def motion_noise(settings: TrackerConfig) -> NDArray[np.float64]:
    """(5,) standard deviations by which twist and accelerations change per scan."""
    return np.array([settings.sigma_vx, settings.sigma_vy, settings.sigma_omega, settings.sigma_ax, settings.sigma_alpha])


def _forget_acceleration(state: State, variances: NDArray[np.float64]) -> State:
    """The state with accelerations of zero that have these variances (2,)."""
    mean, covariance = state.mean.copy(), state.covariance.copy()
    mean[ACCELERATION] = 0.0
    covariance[ACCELERATION, :] = covariance[:, ACCELERATION] = 0.0
    covariance[ACCELERATION, ACCELERATION] = np.diag(variances)
    return State(mean, covariance)
