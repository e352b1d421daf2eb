"""The between-factor of odometry, with the noise that its calibration found."""

from __future__ import annotations

import gtsam

from mqslam.core.measurement import Measurement
from mqslam.factors.noise import between_noise


def odometry_between(a: int, b: int, motion: Measurement) -> gtsam.BetweenFactorPose2:
    """Returns the factor of an odometry motion with its own covariance.

    Args:
        a: key of the pose at the motion's begin.
        b: key of the pose at its end.
        motion: the measurement.
    """
    noise = between_noise(motion.covariance, motion.pose[2])
    return gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(*motion.pose), noise)
