"""The factor of a gyroscope's turn between two poses, whose bias and scale are variables of the graph.

    error = yaw of b - yaw of a - (1 + scale error) turn + bias x duration

It is linear in all its variables, so that one linearisation serves whatever their values are.
"""

from __future__ import annotations

from typing import NamedTuple

import gtsam
import numpy as np

from mqslam.core import se2

_YAW = np.array([[0.0, 0.0, 1.0]])


class GyroscopeTurn(NamedTuple):
    """A turn that a gyroscope measured.

    Args:
        angle: counter-clockwise [rad], less than half a turn away from the true one.
        duration_s: from pose to pose [s].
        sigma: standard deviation of its white noise [rad].
    """

    angle: float
    duration_s: float
    sigma: float


def gyroscope_turn(
    a: int, b: int, calibration: int, turn: GyroscopeTurn, yaws: tuple[float, float]
) -> gtsam.LinearContainerFactor:
    """Returns the factor of a turn.

    Args:
        a: key of the pose (Pose2) at the turn's begin.
        b: key of the pose at its end.
        calibration: key of the gyroscope's calibration, a vector (2,): bias [rad/s] and error of the scale [1].
        turn: the measurement.
        yaws: about the yaws of both poses [rad]; each is right to within half a turn.
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
    """Returns the factor of two successive calibrations of a gyroscope.

    Args:
        a: key of the earlier calibration.
        b: key of the later one.
        walk: standard deviation by which the bias changes in between [rad/s].
        constant: standard deviation by which the scale does [1].
    """
    sigmas = gtsam.noiseModel.Diagonal.Sigmas(np.array([walk, constant]))
    return gtsam.BetweenFactorVector(a, b, np.zeros(2), sigmas)
