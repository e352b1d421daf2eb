"""The tracker's state: eight numbers that say where a scan begins and how the sensor moves while it lasts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.motion import ACCELERATED_TWIST
from mqslam.psi.gaussians import invert
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
    def acceleration(self) -> NDArray[np.float64]:
        """(2,) ax [m/s^2], alpha [rad/s^2], constant while the scan lasts."""
        return self.vector[ACCELERATION]

    @property
    def motion(self) -> se2.Array:
        """(5,) twist and accelerations, the parameters of the motion model."""
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
