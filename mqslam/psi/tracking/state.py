"""Holds the tracker's state, and predicts the state and its covariance from one scan to the next.

The state has eight numbers: x, y [m], yaw [rad] of the sensor at the start of a scan, in the frame of the tracker and its
map (start pose); vx, vy [m/s], omega [rad/s] at the same time, in the sensor's frame (twist); forward acceleration ax
[m/s^2] and yaw acceleration alpha [rad/s^2]. Twist and accelerations together are the motion. Arrays of these quantities and
their covariances have this order and these units.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

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
"""Index of each number in a state vector, and in the rows and columns of a covariance."""
SIZE = 8
POSE, TWIST, ACCELERATION = slice(X, VX), slice(VX, AX), slice(AX, SIZE)
MOTION = slice(VX, SIZE)  # twist and accelerations: the motion model's parameters
TOLERANCES = np.array([1e-3, 1e-3, 2e-5, 5e-3, 5e-3, 1e-4, 2e-2, 1e-3])
"""Steps (8,) of the state that end a search, far below any error; also the state's units when matrices are inverted."""
_FRAME = np.diag([1e-8, 1e-8, 1e-12])  # covariance of a pose that defines the frame: zero but for rounding

# Slowest speed that the cold start tries [m/s]; negative is backwards. Vehicles hardly reverse faster.
SPEED_MIN = -5.0
# Fastest yaw rate that the cold start tries, to either side [rad/s].
OMEGA_MAX = 1.0
# A longer gap [s] is a pause or a jump of the clock. The motion before such a gap is not extrapolated: the error could be
# kilometres.
LONGEST_COAST_S = 60.0
# Longest time between two scans over which an acceleration is assumed to last: in seconds, and, for slow radars, in
# revolutions.
_STEADY_S, _STEADY_TURNS = 0.75, 1.5

_NOISE_PERIOD_S = 0.25  # noise period: process noise and persistence are stated per this time, by definition
# Change of forward speed that acceleration does not explain [m/s], and change of sideways speed [m/s].
_SIGMA_VX, SIGMA_VY = 0.6, 0.15
# Change of forward acceleration [m/s^2].
SIGMA_AX = 4.0
# Change of yaw acceleration for the first scans of a track, and standard deviation of yaw acceleration when nothing is
# known about it [rad/s^2].
START_ALPHA = 0.6
# Process noise of the start pose's position [m], and of its yaw [rad].
_SIGMA_POSITION_M, _SIGMA_YAW = 0.01, 0.0003
# Share of an acceleration that is left after one noise period.
_PERSISTENCE = 0.9

# Standard deviations of odometry between two scans: parts that do not depend on the motion [m], [rad], and as a share of the
# motion.
_GUIDE_M, _GUIDE_RAD, _GUIDE_SHARE = 0.2, 0.01, 0.2

CONTRADICTED: Final = np.diag([1.0, 1.0, 0.1])
"""Covariance of x, y [m], yaw [rad] that is added for a scan that does not match the map at the pose by odometry.

Slipping wheels, for example, make odometry wrong by so much."""

UNSHOWN: Final = np.sqrt(np.diag(CONTRADICTED))
"""Standard deviations [m, m, rad] of a scan's pose along directions that psi did not observe and odometry gave.

The pose graph has separate factors of odometry, which are much more certain along these directions."""

_DEPENDENT = 1e-6  # singular values of unit vectors below this are rounding
_HALF = 0.5**0.5  # root of one half: each of the two poses at the ends of a motion gets half the motion's variance
_WALKS = np.logspace(-3.0, 3.0, 13)  # a walk's step variance over the noise variance: from mostly noise to hardly any noise


@dataclass(frozen=True, slots=True)
class State:
    """The state of a scan: its start pose, and the twist and accelerations of the sensor.

    Args:
        vector: (8,) x, y [m], yaw [rad], vx, vy [m/s], omega [rad/s], ax [m/s^2], alpha [rad/s^2].
    """

    vector: NDArray[np.float64]

    @classmethod
    def of(cls, pose: se2.Array, motion: se2.Array) -> State:
        """Makes a state of a start pose (3,) [m, m, rad] and a motion (5,) as in `State.motion`."""
        return cls(np.r_[pose, motion])

    @classmethod
    def at_constant_twist(cls, pose: se2.Array, twist: se2.Array) -> State:
        """Makes a state of a start pose (3,) [m, m, rad] and a twist (3,) [m/s, m/s, rad/s], without acceleration."""
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
        """(3,) vx [m/s], vy [m/s], omega [rad/s] at the scan's start, in the sensor's frame."""
        return self.vector[TWIST]

    @property
    def motion(self) -> se2.Array:
        """(5,) twist, ax [m/s^2] and alpha [rad/s^2] at the scan's start: the parameters of the motion model."""
        return self.vector[MOTION]

    def moved_ahead(self, distance: float, duration_s: float) -> State:
        """Returns the state of a sensor a distance [m] farther ahead, and faster by this distance per duration [s]."""
        pose = se2.compose(self.pose, np.array([distance, 0.0, 0.0]))
        return State.of(pose, self.motion + np.eye(SIZE)[VX, MOTION] * distance / duration_s)

    def turned(self, angle: float, rate: float) -> State:
        """Returns the state of a sensor that has rotated by an angle [rad] more, and rotates faster by a rate [rad/s]."""
        return State(self.vector + angle * np.eye(SIZE)[YAW] + rate * np.eye(SIZE)[OMEGA])


@dataclass(frozen=True, slots=True)
class Belief:
    """A Gaussian belief about a state.

    Args:
        mean: the most likely state.
        covariance: (8, 8) covariance of the state's vector, in the order of the vector.
    """

    mean: State
    covariance: NDArray[np.float64]

    @property
    def pose(self) -> se2.Array:
        """(3,) the most likely pose at the scan's start [m, m, rad], in the tracker's frame."""
        return self.mean.pose

    @property
    def information(self) -> NDArray[np.float64]:
        """(8, 8) inverse of the covariance, in the order of the vector."""
        return invert(self.covariance, TOLERANCES)

    @property
    def prior(self) -> Prior:
        """The belief as a prior for the minimiser."""
        return Prior(self.mean.vector, self.information)

    def in_its_own_frame(self) -> Belief:
        """Returns the belief with a pose that is known by definition, since it defines the frame of a new map."""
        covariance = self.covariance.copy()
        covariance[POSE, :] = covariance[:, POSE] = 0.0
        covariance[POSE, POSE] = _FRAME
        return Belief(self.mean, covariance)


ORIGIN = Belief(State(np.zeros(SIZE)), np.eye(SIZE))
"""A belief in a sensor at rest at the origin of the tracker's frame; the covariance is the identity."""


@dataclass(frozen=True, slots=True)
class Blindness:
    """The uncertainty of the motion along a direction that psi does not observe, for translation and for rotation.

    Along such a direction the predicted motion is kept. The error of this motion grows with the process noise, up to the
    whole range that the settings allow. While psi does not observe the direction, this one error moves all scans. So the
    standard deviations of their steps add up, not the variances.

    Args:
        speeds: (2,) standard deviations of the speed [m/s] and of the yaw rate [rad/s].
        travelled: (2,) standard deviations of distance [m] and rotation [rad] since psi last observed every direction.
        step: (2,) standard deviations [m, rad] to state for the last step, so that the squares of all steps add up to the
            square of `travelled`.
    """

    speeds: NDArray[np.float64]
    travelled: NDArray[np.float64]
    step: NDArray[np.float64]

    @classmethod
    def none(cls) -> Blindness:
        """Makes the uncertainty after a scan whose motion psi observed: zero."""
        return cls(np.zeros(2), np.zeros(2), np.zeros(2))

    @classmethod
    def full(cls, settings: TrackerConfig) -> Blindness:
        """Makes the uncertainty of a motion that psi never observed: the whole range of speeds."""
        return cls(_bound_speeds(settings), np.zeros(2), np.zeros(2))

    def forget(self, known: NDArray[np.bool_], settings: TrackerConfig) -> Blindness:
        """Returns the uncertainty after other sensors gave the speed or the yaw rate, as the mask `known` (2,) says.

        For a quantity that they gave, the uncertainty of the distance (or rotation) begins at zero again, and the speed (or
        yaw rate) may lie anywhere in its range, because psi did not measure it.
        """
        speeds = np.where(known, _bound_speeds(settings), self.speeds)
        return Blindness(speeds, np.where(known, 0.0, self.travelled), np.where(known, 0.0, self.step))

    def after(self, dt: float, settings: TrackerConfig) -> Blindness:
        """Returns the uncertainty a time dt [s] later, if psi has not observed the direction since."""
        walk = np.square([_SIGMA_VX, settings.sigma_omega]) * (dt / _NOISE_PERIOD_S)
        speeds = np.minimum(np.sqrt(self.speeds**2 + walk), _bound_speeds(settings))
        travelled = self.travelled + speeds * dt
        return Blindness(speeds, travelled, np.sqrt(travelled**2 - self.travelled**2))

    @property
    def pose(self) -> NDArray[np.float64]:
        """(3,) standard deviations [m, m, rad] to state for a scan's start pose: half the variance of the last step.

        The other half belongs to the pose at the start of this step.
        """
        return np.asarray(self.step[[0, 0, 1]] * _HALF)


@dataclass(frozen=True, slots=True)
class LastMatch:
    """The last scan that was matched, from which the next scans are predicted.

    Args:
        t0: start of the scan [s since the recording's start].
        turn_s: duration of the scan [s]; the radar may revolve at another rate later.
        belief: belief about the scan's state.
        blind: uncertainty of the motion along directions that psi does not observe.
        twists: twists (3,) [m/s, m/s, rad/s] of the last scans in which psi observed every direction, in the order of time.
    """

    t0: float
    turn_s: float
    belief: Belief
    blind: Blindness
    twists: tuple[se2.Array, ...] = ()

    @property
    def pose(self) -> se2.Array:
        """(3,) start pose of the scan [m, m, rad], in the tracker's frame."""
        return self.belief.pose

    def is_before(self, scan: Scan) -> bool:
        """Returns whether a scan follows so soon that the acceleration is assumed to last until its start."""
        return scan.t0 - self.t0 <= limit_step(self.turn_s)

    def predict(self, scan: Scan, settings: TrackerConfig) -> Belief:
        """Predicts the state at the start of a later scan.

        If the scan follows soon (`is_before`), the acceleration is assumed to last (see the function `predict`), and after a
        longer gap the twist (see `coast`). After more than LONGEST_COAST_S, the sensor is assumed to rest at its last pose.
        """
        dt, belief = scan.t0 - self.t0, self.belief
        if self.is_before(scan):
            return predict(belief, dt, settings)
        if dt > LONGEST_COAST_S:
            belief = Belief(State.at_constant_twist(belief.pose, np.zeros(3)), belief.covariance)
        return coast(belief, min(dt, LONGEST_COAST_S), self.turn_s, settings)

    def predict_steadily(self, scan: Scan, settings: TrackerConfig) -> State | None:
        """Predicts the state of a later scan from the smoothed twist of the last scans; returns None if `twists` is empty.

        The twist of a single match errs by a few tenths of a metre per second. This is harmless if the next scan is
        matched again, but adds up where psi does not observe a direction for some time.
        """
        if not self.twists:
            return None
        axes = zip(np.transpose(self.twists), list_motion_noise(settings)[:3], strict=True)
        twist = np.array([smooth_last(values, change) for values, change in axes])
        return State.at_constant_twist(se2.compose(self.pose, se2.exp(twist, scan.t0 - self.t0)), twist)


def predict(belief: Belief, dt: float, settings: TrackerConfig) -> Belief:
    """Predicts the state: pose and twist at constant acceleration, and an acceleration that has decayed towards zero.

    Args:
        belief: belief about the state at the start.
        dt: time from the start to the predicted state [s]; negative predicts an earlier state.
        settings: process noise, and the standard deviation of stamps.
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
    velocity = np.array([*(_rotation(pose[2])[:2, :2] @ [vx, vy]), omega])  # by which a wrong stamp moves the pose
    joint[POSE, POSE] += 2.0 * (settings.stamp_sigma_s or 0.0) ** 2 * np.outer(velocity, velocity)
    return Belief(State.of(pose, motion), symmetric(joint))


def guide(belief: Belief, twist: se2.Array, dt: float) -> Belief:
    """Predicts the state by odometry, whose error grows with the distance and with the angle of the motion.

    Args:
        belief: belief about the state at the start.
        twist: (3,) mean twist [m/s, m/s, rad/s] by odometry, without NaN.
        dt: time from the start to the predicted state [s]; negative predicts an earlier state.
    """
    step = se2.exp(twist, dt)
    pose = se2.compose(belief.pose, step)
    far, turn = float(np.hypot(step[0], step[1])), abs(float(step[2]))
    off_m, off_rad = _GUIDE_M + _GUIDE_SHARE * far, _GUIDE_RAD + _GUIDE_SHARE * turn
    motion = np.square([_SIGMA_VX, SIGMA_VY, START_ALPHA, SIGMA_AX, START_ALPHA])
    covariance = np.diag(np.r_[off_m**2, off_m**2, off_rad**2, motion])
    covariance[POSE, POSE] += belief.covariance[POSE, POSE]
    return Belief(State.at_constant_twist(pose, twist), covariance)


def coast(belief: Belief, dt: float, turn_s: float, settings: TrackerConfig) -> Belief:
    """Predicts the state a long time later: the twist is kept, and its possible changes add up with each revolution.

    No vehicle brakes for long, so the acceleration is forgotten: at the end it is as unknown as at the start of a recording.

    Args:
        belief: belief about the state at the start.
        dt: time from the start to the predicted state [s], more than a revolution of the radar.
        turn_s: duration of a revolution of the radar [s], the step in which changes of the twist are added.
        settings: process noise.
    """
    steps = max(1, round(dt / turn_s))
    belief = _forget_acceleration(belief, np.zeros(2))
    for _ in range(steps):
        belief = _forget_acceleration(predict(belief, dt / steps, settings), np.zeros(2))
    return _forget_acceleration(belief, np.square([SIGMA_AX, START_ALPHA]))


def _forget_acceleration(belief: Belief, variances: NDArray[np.float64]) -> Belief:
    """Returns the belief with accelerations of zero, whose variances (2,) are given [(m/s^2)^2, (rad/s^2)^2]."""
    covariance = belief.covariance.copy()
    covariance[ACCELERATION, :] = covariance[:, ACCELERATION] = 0.0
    covariance[ACCELERATION, ACCELERATION] = np.diag(variances)
    return Belief(State.at_constant_twist(belief.pose, belief.mean.twist), covariance)


def smooth_last(values: NDArray[np.float64], change: float) -> float:
    """Estimates a changing value at the time of the last of several noisy measurements.

    The value is modelled as a random walk that is measured with noise. The ratio of the walk's variance to the noise's
    variance is not known, so Kalman filters for several ratios are averaged. Each filter is weighted by the likelihood of
    the measurements under its ratio, and by how plausible the typical step of its walk is, given `change`. If the values
    differ only by noise, the result is nearly their mean; without noise, nearly the last measurement.

    Source: the local level model of Harvey, "Forecasting, Structural Time Series Models and the Kalman Filter" (1989).

    Args:
        values: (N,) one or more measurements in the order of time, in any unit; the result has the same unit.
        change: expected size of a step of the walk, in the unit of the values. Among few measurements, only this
            distinguishes noise from a real change.
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
    """Corrects a belief by a measured motion (5,), in the order of `State.motion`, with a covariance (5, 5)."""
    gain = belief.covariance[:, MOTION] @ invert(belief.covariance[MOTION, MOTION] + covariance, TOLERANCES[MOTION])
    kept = np.eye(SIZE)
    kept[:, MOTION] -= gain
    joint = kept @ belief.covariance @ kept.T + gain @ covariance @ gain.T
    return Belief(State(belief.mean.vector + gain @ (motion - belief.mean.motion)), symmetric(joint))


def replace_motion(belief: Belief, motion: se2.Array, covariance: NDArray[np.float64]) -> Belief:
    """Returns a belief with the same pose and another motion (5,), in the order of `State.motion`.

    The motion has the given covariance (5, 5), and is not correlated with the pose.
    """
    joint = np.zeros((SIZE, SIZE))
    joint[POSE, POSE] = belief.covariance[POSE, POSE]
    joint[MOTION, MOTION] = covariance
    return Belief(State.of(belief.pose, motion), joint)


def limit_step(turn_s: float) -> float:
    """Returns the longest time [s] between the starts of two scans that counts as no gap, if a scan lasts `turn_s` [s]."""
    return max(_STEADY_S, _STEADY_TURNS * turn_s)


def hold_directions(prior: Prior, weak: NDArray[np.float64]) -> Prior:
    """Returns a prior that keeps pose, twist and accelerations at its mean along directions (K, 3) of the start pose."""
    along = _follow_directions(weak, prior.mean[YAW]) / TOLERANCES
    return Prior(prior.mean, prior.information + along.T @ along)


def drop_directions(information: NDArray[np.float64], weak: NDArray[np.float64], yaw: float) -> NDArray[np.float64]:
    """Removes from an information matrix (8, 8) the information along directions (K, 3) that psi does not observe.

    Args:
        information: information of psi alone.
        weak: directions of the start pose (x, y [m], yaw [rad]); twist and accelerations along them lose their information,
            too.
        yaw: yaw of the start pose [rad].
    """
    if not len(weak):
        return information
    units = TOLERANCES[:, None] * TOLERANCES[None, :]
    _, values, basis = np.linalg.svd(_follow_directions(weak, yaw), full_matrices=False)
    basis = basis[values > _DEPENDENT]
    across = np.eye(SIZE) - basis.T @ basis
    return np.asarray(across @ (information * units) @ across / units)


def _follow_directions(weak: NDArray[np.float64], yaw: float) -> NDArray[np.float64]:
    """Returns unit vectors (L, 8) of the state along directions (K, 3) of the start pose, with `TOLERANCES` as units.

    Each direction gives one vector for the pose, one for the twist and one for the accelerations, if they are not zero.
    """
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
    """Returns standard deviations (5,) of changes of vx, vy [m/s], omega [rad/s], ax [m/s^2], alpha [rad/s^2] in 0.25 s."""
    return np.array([_SIGMA_VX, SIGMA_VY, settings.sigma_omega, SIGMA_AX, settings.sigma_alpha])


def _bound_speeds(settings: TrackerConfig) -> NDArray[np.float64]:
    """Returns the standard deviations (2,) of speed [m/s] and yaw rate [rad/s] if only their possible range is known."""
    ranges = np.array([settings.speed_max - SPEED_MIN, 2.0 * OMEGA_MAX])
    return np.asarray(ranges / np.sqrt(12.0))  # all speeds of the range are equally likely


def _rotation(yaw: float) -> NDArray[np.float64]:
    """Returns the matrix (3, 3) that converts twists from a frame that is rotated by yaw [rad] to the unrotated frame."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
