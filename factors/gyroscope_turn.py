"""The factor of the rotation that a gyroscope measures between two poses.

    error = yaw of b - yaw of a - (1 + scale error) x angle + bias x duration

The bias and the scale error of the gyroscope are variables of the graph. The error is linear in all variables, so it has to
be linearised only once.
"""

from __future__ import annotations

from typing import NamedTuple

import gtsam
import numpy as np

from mqslam.core import se2

_YAW = np.array([[0.0, 0.0, 1.0]])


class GyroscopeTurn(NamedTuple):
    """A rotation of the vehicle that a gyroscope measured.

    Args:
        angle: measured angle, counter-clockwise [rad]; its size is less than pi.
        duration_s: duration of the rotation [s].
        sigma: standard deviation of the angle from white noise [rad].
    """

    angle: float
    duration_s: float
    sigma: float


def gyroscope_turn(
    a: int, b: int, calibration: int, turn: GyroscopeTurn, yaws: tuple[float, float]
) -> gtsam.LinearContainerFactor:
    """Returns the factor of a measured rotation of the vehicle.

    Args:
        a: key of the pose (Pose2) at the beginning of the rotation.
        b: key of the pose (Pose2) at the end of the rotation.
        calibration: key of the gyroscope's calibration, a vector (2,): bias [rad/s] and scale error [1].
        turn: the measurement.
        yaws: approximate yaws of the poses a and b [rad]. Their difference, wrapped to [-pi, pi), must be near the measured
            angle: beside -pi or pi, an error could add a whole turn.
    """
    by_calibration = np.array([[turn.duration_s, -turn.angle]])
    miss = turn.angle - se2.wrap(yaws[1] - yaws[0])
    noise = gtsam.noiseModel.Isotropic.Sigma(1, turn.sigma)
    linear = gtsam.JacobianFactor(a, -_YAW, b, _YAW, calibration, by_calibration, np.array([miss]), noise)
    point = gtsam.Values()
    point.insert(a, gtsam.Pose2(0.0, 0.0, yaws[0]))
    point.insert(b, gtsam.Pose2(0.0, 0.0, yaws[1]))
    point.insert(calibration, np.zeros(2))
    return gtsam.LinearContainerFactor(linear, point)


def bias_walk(a: int, b: int, walk: float, constant: float) -> gtsam.BetweenFactorVector:
    """Returns the factor between two successive calibrations of a gyroscope.

    Args:
        a: key of the earlier calibration.
        b: key of the later calibration.
        walk: standard deviation of the change of the bias from the earlier to the later calibration [rad/s].
        constant: standard deviation of the change of the scale error between the same calibrations [1].
    """
    sigmas = gtsam.noiseModel.Diagonal.Sigmas(np.array([walk, constant]))
    return gtsam.BetweenFactorVector(a, b, np.zeros(2), sigmas)
