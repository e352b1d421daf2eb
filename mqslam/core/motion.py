"""Motion models: the sensor's pose within a window as a function of a few parameters.

Every model states the body twist as a polynomial in time, linear in the parameters. The pose follows by integrating

    yaw(t) = int_0^t omega,    (x, y)(t) = int_0^t R(yaw(u)) (vx, vy)(u) du

by Gauss-Legendre quadrature from one time to the next. Six nodes are exact to rounding for rotations below a radian; two
nodes, which are faster, are as exact for the small rotations between azimuths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2

VX, VY, OMEGA = 0, 1, 2


def _spread_nodes(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns `count` Gauss-Legendre nodes (count,) between 0 and 1, and their weights (count,)."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 * (nodes + 1.0), 0.5 * weights


_NODES, _WEIGHTS = _spread_nodes(6)
_FEW_NODES, _FEW_WEIGHTS = _spread_nodes(2)
_SHORT_TURN = 0.005  # yaw step [rad] below which two nodes are exact to rounding: the error falls with its fifth power


@dataclass(frozen=True, slots=True)
class MotionModel:
    """A body twist that is a polynomial in time.

    Parameter p adds theta[p] * t**powers[p] to twist component components[p] (0 vx [m/s], 1 vy [m/s], 2 omega [rad/s]).

    Args:
        name: name of the model.
        parameters: (P,) names of the parameters.
        components: (P,) the twist component that each parameter adds to.
        powers: (P,) the power of time that each parameter is multiplied by.
    """

    name: str
    parameters: tuple[str, ...]
    components: tuple[int, ...]
    powers: tuple[int, ...]

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    def pose(self, theta: se2.Array, t: float) -> tuple[se2.Array, se2.Array]:
        """Returns the pose (3,) after t [s], in the frame at t = 0, and its Jacobian (3, P) by the parameters."""
        poses, jacobians, _ = integrate(np.asarray(theta, dtype=np.float64), *self.arrays, np.array([t]))
        return poses[0], jacobians[0]

    @property
    def arrays(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The components (P,) and the powers (P,), as arrays for compiled code."""
        return np.array(self.components, dtype=np.int64), np.array(self.powers, dtype=np.int64)

    def from_twist(self, twist: se2.Array) -> se2.Array:
        """Returns the parameters (P,) of a constant twist (vx, vy, omega); a component that the model lacks is ignored."""
        theta = np.zeros(self.size)
        for p, (component, power) in enumerate(zip(self.components, self.powers, strict=True)):
            if power == 0:
                theta[p] = twist[component]
        return theta


CONSTANT_VELOCITY = MotionModel("constant_velocity", ("v", "omega"), (VX, OMEGA), (0, 0))
CONSTANT_TWIST = MotionModel("constant_twist", ("vx", "vy", "omega"), (VX, VY, OMEGA), (0, 0, 0))
ACCELERATED_TWIST = MotionModel(
    "accelerated_twist", ("vx", "vy", "omega", "ax", "alpha"), (VX, VY, OMEGA, VX, OMEGA), (0, 0, 0, 1, 1)
)


@nb.njit(cache=True, inline="always")
def raise_to(base: float, power: int) -> float:
    """Returns base**power by repeated multiplication, which is faster for the low powers of the motion models."""
    result = 1.0
    for _ in range(power):
        result *= base
    return result


@nb.njit(cache=True, nogil=True)
def integrate(
    theta: NDArray[np.float64],
    components: NDArray[np.int64],
    powers: NDArray[np.int64],
    times: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Integrates a body twist over time.

    Args:
        theta: (P,) parameters of a motion model.
        components: (P,) twist component of each parameter.
        powers: (P,) power of time of each parameter.
        times: (N,) [s] since the window's start, not decreasing.

    Returns:
        Poses (N, 3) in the frame at the window's start [m, m, rad], their Jacobians (N, 3, P) by the parameters, and body
        twists (N, 3) [m/s, m/s, rad/s], all at the times.
    """
    n, size = len(times), len(theta)
    poses = np.zeros((n, 3))
    jacobians = np.zeros((n, 3, size))
    twists = np.zeros((n, 3))
    d_yaw, bases = np.zeros(size), np.zeros(size)
    before, turned = 0.0, 0.0  # the time up to which the twist has been integrated, and the yaw at that time
    for i in range(n):
        t = times[i]
        if i > 0:
            poses[i], jacobians[i] = poses[i - 1], jacobians[i - 1]
        if i > 0 and t == before:  # the returns of one azimuth share their time
            twists[i] = twists[i - 1]
            continue
        yaw = 0.0
        for p in range(size):
            base = raise_to(t, powers[p])
            twists[i, components[p]] += theta[p] * base
            if components[p] == OMEGA:
                yaw += theta[p] * base * t / (powers[p] + 1)
                jacobians[i, 2, p] = base * t / (powers[p] + 1)
        poses[i, 2] = yaw
        is_short = abs(yaw - turned) < _SHORT_TURN
        nodes, weights = (_FEW_NODES, _FEW_WEIGHTS) if is_short else (_NODES, _WEIGHTS)
        for node in range(len(nodes)):
            u = before + (t - before) * nodes[node]
            weight = (t - before) * weights[node]
            yaw_there = 0.0
            vx = 0.0
            vy = 0.0
            for p in range(size):
                base = raise_to(u, powers[p])
                bases[p] = base
                d_yaw[p] = 0.0
                if components[p] == OMEGA:
                    d_yaw[p] = base * u / (powers[p] + 1)
                    yaw_there += theta[p] * d_yaw[p]
                elif components[p] == VX:
                    vx += theta[p] * base
                else:
                    vy += theta[p] * base
            c, s = np.cos(yaw_there), np.sin(yaw_there)
            ahead = c * vx - s * vy
            left = s * vx + c * vy
            poses[i, 0] += weight * ahead
            poses[i, 1] += weight * left
            for p in range(size):
                base = bases[p]
                if components[p] == OMEGA:
                    jacobians[i, 0, p] -= weight * left * d_yaw[p]
                    jacobians[i, 1, p] += weight * ahead * d_yaw[p]
                elif components[p] == VX:
                    jacobians[i, 0, p] += weight * c * base
                    jacobians[i, 1, p] += weight * s * base
                else:
                    jacobians[i, 0, p] -= weight * s * base
                    jacobians[i, 1, p] += weight * c * base
        before, turned = t, yaw
    return poses, jacobians, twists
