"""The tracker's state: eight numbers that say where a scan begins and how the sensor moves while it lasts.

Here is how the state moves on from one scan to the next, and what is known of it then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.config import TrackerConfig
from mqslam.core import se2
from mqslam.core.motion import ACCELERATED_TWIST
from mqslam.core.scans import Scan
from mqslam.psi.covariance import invert, symmetric
from mqslam.psi.minimiser import Prior

MODEL = ACCELERATED_TWIST
X, Y, YAW, VX, VY, OMEGA, AX, ALPHA = range(8)
"""Where each of the numbers is in a vector, in the rows and in the columns of a covariance."""
SIZE = 8
POSE, TWIST, ACCELERATION = slice(X, VX), slice(VX, AX), slice(AX, SIZE)
MOTION = slice(VX, SIZE)  # twist and accelerations: the motion model's parameters
TOLERANCES = np.array([1e-3, 1e-3, 2e-5, 5e-3, 5e-3, 1e-4, 2e-2, 1e-3])
"""Steps of the state that end a search, and its units where matrices are inverted: numerical, far below any error."""
_FRAME = np.diag([1e-8, 1e-8, 1e-12])  # covariance of a pose that defines the frame: zero but for rounding

# Slowest speed that the cold start tries [m/s]; negative is backwards. Vehicles hardly reverse faster.
SPEED_MIN = -5.0
# Fastest yaw rate that the cold start tries, to either side [rad/s].
OMEGA_MAX = 1.0
# A longer gap is a pause or a jump of the clock [s]. No motion is extrapolated across it: that could mean kilometres.
LONGEST_COAST_S = 60.0
# Longest time between two scans over which an acceleration is taken to last: in seconds, and in turns for slow radars.
_STEADY_S, _STEADY_TURNS = 0.75, 1.5

_NOISE_PERIOD_S = 0.25  # process noise and persistence are stated per this time: a definition
# Change of forward speed that acceleration does not explain [m/s], and of sideways speed [m/s].
_SIGMA_VX, SIGMA_VY = 0.6, 0.15
# Change of forward acceleration [m/s^2].
SIGMA_AX = 4.0
# Change of yaw acceleration for the first scans of a track, and its standard deviation when nothing is known [rad/s^2].
START_ALPHA = 0.6
# Process noise of the start pose's position [m], and of its yaw [rad].
_SIGMA_POSITION_M, _SIGMA_YAW = 0.01, 0.0003
# Share of an acceleration that is left.
_PERSISTENCE = 0.9

_DEPENDENT = 1e-6  # singular values of unit vectors below this are rounding
_HALF = 0.5**0.5  # half of a variance: a motion between two scans has the variances of both of their poses
_WALKS = np.logspace(-3.0, 3.0, 13)  # variances of a walk's step over that of noise: from all noise to none


@dataclass(frozen=True, slots=True)
class State:
    """The motion of a scan.

    Args:
        vector: (8,) all parts, one after the other: pose, twist, acceleration.
    """

    vector: NDArray[np.float64]

    @classmethod
    def of(cls, pose: se2.Array, motion: se2.Array) -> State:
        """Makes a state of a start pose (3,) and a motion (5,): twist and accelerations."""
        return cls(np.r_[pose, motion])

    @classmethod
    def at_constant_twist(cls, pose: se2.Array, twist: se2.Array) -> State:
        """Makes a state of a start pose (3,) and a twist (3,), without acceleration."""
        return cls(np.r_[pose, twist, 0.0, 0.0])

    @property
    def pose(self) -> se2.Array:
        """(3,) x [m], y [m], yaw [rad] at the scan's start, in the tracker's frame."""
        return self.vector[POSE]

    @property
    def yaw(self) -> float:
        """Yaw at the scan's start [rad]."""
        return float(self.vector[YAW])

    @property
    def twist(self) -> se2.Array:
        """(3,) vx [m/s], vy [m/s], omega [rad/s] at the scan's start, in the body frame."""
        return self.vector[TWIST]

    @property
    def motion(self) -> se2.Array:
        """(5,) twist and accelerations (ax [m/s^2], alpha [rad/s^2]) while the scan lasts: the motion model's parameters."""
        return self.vector[MOTION]

    def moved_ahead(self, distance: float, duration_s: float) -> State:
        """Returns the state of a sensor that came farther ahead [m] in a time [s], and is faster by as much."""
        pose = se2.compose(self.pose, np.array([distance, 0.0, 0.0]))
        return State.of(pose, self.motion + np.eye(SIZE)[VX, MOTION] * distance / duration_s)

    def turned(self, angle: float, rate: float) -> State:
        """Returns the state of a sensor that has turned by an angle [rad] more, and turns faster [rad/s]."""
        return State(self.vector + angle * np.eye(SIZE)[YAW] + rate * np.eye(SIZE)[OMEGA])


@dataclass(frozen=True, slots=True)
class Belief:
    """What is known of a state.

    Args:
        mean: the state that is most likely.
        covariance: (8, 8) of its vector.
    """

    mean: State
    covariance: NDArray[np.float64]

    @property
    def pose(self) -> se2.Array:
        """(3,) start pose [m, m, rad]."""
        return self.mean.pose

    @property
    def information(self) -> NDArray[np.float64]:
        """(8, 8) inverse of the covariance."""
        return invert(self.covariance, TOLERANCES)

    @property
    def prior(self) -> Prior:
        """The belief as the prior of a minimisation."""
        return Prior(self.mean.vector, self.information)

    def in_its_own_frame(self) -> Belief:
        """Returns the belief with a pose that defines the frame, so that it is known and independent of the motion."""
        covariance = self.covariance.copy()
        covariance[POSE, :] = covariance[:, POSE] = 0.0
        covariance[POSE, POSE] = _FRAME
        return Belief(self.mean, covariance)


ORIGIN = Belief(State(np.zeros(SIZE)), np.eye(SIZE))
"""At rest where the tracker's frame begins."""


@dataclass(frozen=True, slots=True)
class Blindness:
    """What is unknown of the motion along a direction that psi does not observe, for travel and for turning.

    The motion is held there, and its error grows as the process noise allows, up to all that the settings think possible.
    Such an error is common to all scans of the stretch, so that those of their poses add up as they are, not in square.

    Args:
        speeds: (2,) standard deviations of the speed [m/s] and of the yaw rate [rad/s].
        travelled: (2,) standard deviations of what the stretch has led through so far [m, rad].
        step: (2,) standard deviations of the last scan's part of that, given that such parts add up in square [m, rad].
    """

    speeds: NDArray[np.float64]
    travelled: NDArray[np.float64]
    step: NDArray[np.float64]

    @classmethod
    def none(cls) -> Blindness:
        """Returns what is unknown of a motion that psi has just observed: nothing."""
        return cls(np.zeros(2), np.zeros(2), np.zeros(2))

    @classmethod
    def full(cls, settings: TrackerConfig) -> Blindness:
        """Returns what is unknown of a motion that was never observed."""
        return cls(_bound_speeds(settings), np.zeros(2), np.zeros(2))

    def forget(self, known: NDArray[np.bool_], settings: TrackerConfig) -> Blindness:
        """Returns what psi knows of a motion whose travel, turn, or both (2,) are known from others: nothing of these."""
        speeds = np.where(known, _bound_speeds(settings), self.speeds)
        return Blindness(speeds, np.where(known, 0.0, self.travelled), np.where(known, 0.0, self.step))

    def after(self, dt: float, settings: TrackerConfig) -> Blindness:
        """Returns what is unknown a time dt [s] later."""
        walk = np.square([_SIGMA_VX, settings.sigma_omega]) * (dt / _NOISE_PERIOD_S)
        speeds = np.minimum(np.sqrt(self.speeds**2 + walk), _bound_speeds(settings))
        travelled = self.travelled + speeds * dt
        return Blindness(speeds, travelled, np.sqrt(travelled**2 - self.travelled**2))

    @property
    def pose(self) -> NDArray[np.float64]:
        """(3,) standard deviations of a scan's start pose [m, m, rad]: its own step, half of which counts at either end."""
        return np.asarray(self.step[[0, 0, 1]] * _HALF)


@dataclass(frozen=True, slots=True)
class LastMatch:
    """The last scan that was matched, from which the next ones are predicted.

    Args:
        t0: its start [s].
        turn_s: its duration [s]; the radar may turn at another rate later.
        belief: what is known of its state.
        blind: what is unknown of the motion where psi does not observe it.
        twists: (3,) each, of the last scans whose motion psi observed.
    """

    t0: float
    turn_s: float
    belief: Belief
    blind: Blindness
    twists: tuple[se2.Array, ...] = ()

    @property
    def pose(self) -> se2.Array:
        """(3,) its start pose."""
        return self.belief.pose

    def is_before(self, scan: Scan) -> bool:
        """Returns whether a scan follows so soon that the acceleration lasts."""
        return scan.t0 - self.t0 <= limit_step(self.turn_s)

    def predict(self, scan: Scan, settings: TrackerConfig) -> Belief:
        """Predicts the state of a later scan."""
        dt, belief = scan.t0 - self.t0, self.belief
        if self.is_before(scan):
            return predict(belief, dt, settings)
        if dt > LONGEST_COAST_S:
            belief = Belief(State.at_constant_twist(belief.pose, np.zeros(3)), belief.covariance)
        return coast(belief, min(dt, LONGEST_COAST_S), self.turn_s, settings)

    def predict_steadily(self, scan: Scan, settings: TrackerConfig) -> State | None:
        """Predicts the state of a later scan at the smoothed twist of the last ones, or returns None where there were none.

        The twist of a single match errs by a few tenths of a metre per second. That is little for the next scan, which is
        matched in turn, and too much where scans are not matched along a direction for some time.
        """
        if not self.twists:
            return None
        axes = zip(np.transpose(self.twists), list_motion_noise(settings)[:3], strict=True)
        twist = np.array([smooth_last(values, change) for values, change in axes])
        return State.at_constant_twist(se2.compose(self.pose, se2.exp(twist, scan.t0 - self.t0)), twist)


def predict(belief: Belief, dt: float, settings: TrackerConfig) -> Belief:
    """Predicts the state at constant acceleration.

    Args:
        belief: what is known at the start.
        dt: how much later [s], or earlier where it is negative.
        settings: process noise.
    """
    before = belief.mean
    vx, vy, omega, ax, alpha = before.motion
    step, by_motion = MODEL.pose(before.motion, dt)
    pose = se2.compose(before.pose, step)
    persistence = _PERSISTENCE ** (abs(dt) / _NOISE_PERIOD_S)
    transition = np.eye(SIZE)
    transition[POSE, MOTION] = _rotation(before.yaw) @ by_motion
    transition[:YAW, YAW] = before.pose[1] - pose[1], pose[0] - before.pose[0]
    transition[VX, AX] = transition[OMEGA, ALPHA] = dt
    transition[AX, AX] = transition[ALPHA, ALPHA] = persistence
    motion = np.array([vx + dt * ax, vy, omega + dt * alpha, persistence * ax, persistence * alpha])
    pose_noise = [_SIGMA_POSITION_M, _SIGMA_POSITION_M, _SIGMA_YAW]
    noise = np.square(np.r_[pose_noise, list_motion_noise(settings)]) * (abs(dt) / _NOISE_PERIOD_S)
    joint = transition @ belief.covariance @ transition.T + np.diag(noise)
    velocity = np.array([*(_rotation(pose[2])[:2, :2] @ [vx, vy]), omega])  # over which a wrong stamp carries the pose
    joint[POSE, POSE] += 2.0 * (settings.stamp_sigma_s or 0.0) ** 2 * np.outer(velocity, velocity)
    return Belief(State.of(pose, motion), symmetric(joint))


def coast(belief: Belief, dt: float, turn_s: float, settings: TrackerConfig) -> Belief:
    """Predicts the state a long time later: the twist is followed, and its changes add up turn by turn.

    Nobody brakes for long, so the acceleration is forgotten: it is as unknown at the end as at the start of a recording.

    Args:
        belief: what is known at the start.
        dt: how much later [s], more than a turn.
        turn_s: duration of a turn [s], the step in which changes of the twist are added.
        settings: process noise.
    """
    steps = max(1, round(dt / turn_s))
    belief = _forget_acceleration(belief, np.zeros(2))
    for _ in range(steps):
        belief = _forget_acceleration(predict(belief, dt / steps, settings), np.zeros(2))
    return _forget_acceleration(belief, np.square([SIGMA_AX, START_ALPHA]))


def _forget_acceleration(belief: Belief, variances: NDArray[np.float64]) -> Belief:
    """Returns the belief with accelerations of zero that have these variances (2,)."""
    covariance = belief.covariance.copy()
    covariance[ACCELERATION, :] = covariance[:, ACCELERATION] = 0.0
    covariance[ACCELERATION, ACCELERATION] = np.diag(variances)
    return Belief(State.at_constant_twist(belief.pose, belief.mean.twist), covariance)


def smooth_last(values: NDArray[np.float64], change: float) -> float:
    """Returns where a value is at the last of successive measurements of it.

    The value is taken to walk at random, and to be measured with noise. How the variances of the two compare is not known:
    Kalman filters for several ratios are averaged, each by how likely the measurements are under it, and by how likely the
    walk is that it says they show. Where all is noise, the mean remains, and without noise the last measurement.

    Source: the local level model of Harvey, "Forecasting, Structural Time Series Models and the Kalman Filter" (1989).

    Args:
        values: (N,) one or more, in the order of time.
        change: by how much a step of the walk may be expected to change the value. With it alone, few measurements that are
            far apart are known to be noise.
    """
    levels, variances = np.full(len(_WALKS), values[0]), np.ones(len(_WALKS))  # in units of the noise's variance
    squares, logs = np.full(len(_WALKS), np.finfo(float).tiny), np.zeros(len(_WALKS))
    for value in values[1:]:
        spread = variances + _WALKS + 1.0
        surprise, gains = value - levels, 1.0 - 1.0 / spread
        squares, logs = squares + surprise**2 / spread, logs + np.log(spread)
        levels, variances = levels + gains * surprise, gains
    steps = max(len(values) - 1, 1)
    logs += steps * np.log(squares) + _WALKS * squares / (steps * change**2)
    return float(np.average(levels, weights=np.exp(-0.5 * (logs - logs.min()))))


def correct_motion(belief: Belief, motion: se2.Array, covariance: NDArray[np.float64]) -> Belief:
    """Corrects a belief by a measurement of twist and accelerations (5,) with a covariance (5, 5)."""
    gain = belief.covariance[:, MOTION] @ invert(belief.covariance[MOTION, MOTION] + covariance, TOLERANCES[MOTION])
    kept = np.eye(SIZE)
    kept[:, MOTION] -= gain
    joint = kept @ belief.covariance @ kept.T + gain @ covariance @ gain.T
    return Belief(State(belief.mean.vector + gain @ (motion - belief.mean.motion)), symmetric(joint))


def replace_motion(belief: Belief, motion: se2.Array, covariance: NDArray[np.float64]) -> Belief:
    """Replaces twist and accelerations by others (5,) of a covariance (5, 5), which do not depend on the pose."""
    joint = np.zeros((SIZE, SIZE))
    joint[POSE, POSE] = belief.covariance[POSE, POSE]
    joint[MOTION, MOTION] = covariance
    return Belief(State.of(belief.pose, motion), joint)


def limit_step(turn_s: float) -> float:
    """Returns the longest time [s] between the starts of scans that follow each other: one may be missing, not many."""
    return max(_STEADY_S, _STEADY_TURNS * turn_s)


def hold_directions(prior: Prior, weak: NDArray[np.float64]) -> Prior:
    """Makes a prior stiff along directions (K, 3) that psi does not observe: for pose, twist and acceleration."""
    along = _follow_directions(weak, prior.mean[YAW]) / TOLERANCES
    return Prior(prior.mean, prior.information + along.T @ along)


def drop_directions(information: NDArray[np.float64], weak: NDArray[np.float64], yaw: float) -> NDArray[np.float64]:
    """Takes from an information matrix (8, 8) what it claims to know along directions (K, 3) that psi does not observe.

    Args:
        information: of psi alone.
        weak: the directions, for the start pose.
        yaw: of the start pose [rad].
    """
    if not len(weak):
        return information
    units = TOLERANCES[:, None] * TOLERANCES[None, :]
    _, values, basis = np.linalg.svd(_follow_directions(weak, yaw), full_matrices=False)
    basis = basis[values > _DEPENDENT]
    across = np.eye(SIZE) - basis.T @ basis
    return np.asarray(across @ (information * units) @ across / units)


def _follow_directions(weak: NDArray[np.float64], yaw: float) -> NDArray[np.float64]:
    """Returns unit vectors (L, 8), in units of the tolerances, along directions (K, 3) of pose, twist and acceleration."""
    to_body = _rotation(-yaw)
    vectors = []
    for direction in weak:
        body = to_body @ direction
        for block, along in ((POSE, direction), (TWIST, body), (ACCELERATION, body[[0, 2]])):
            vector = np.zeros(SIZE)
            vector[block] = along / TOLERANCES[block]
            length = float(np.linalg.norm(vector))
            if length > 0.0:
                vectors.append(vector / length)
    return np.array(vectors).reshape(-1, SIZE)


def list_motion_noise(settings: TrackerConfig) -> NDArray[np.float64]:
    """Returns the standard deviations (5,) by which twist and accelerations change per scan."""
    return np.array([_SIGMA_VX, SIGMA_VY, settings.sigma_omega, SIGMA_AX, settings.sigma_alpha])


def _bound_speeds(settings: TrackerConfig) -> NDArray[np.float64]:
    """Returns the standard deviations (2,) of speed [m/s] and yaw rate [rad/s] when nothing is known of them."""
    ranges = np.array([settings.speed_max - SPEED_MIN, 2.0 * OMEGA_MAX])
    return np.asarray(ranges / np.sqrt(12.0))  # all in the range are as likely


def _rotation(yaw: float) -> NDArray[np.float64]:
    """Returns the matrix (3, 3) that carries a twist from a frame that is rotated by yaw [rad] to the frame that is not."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
