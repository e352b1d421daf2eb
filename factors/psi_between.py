"""The between-factor of a front end's measurement: psi's, or that of the front end standing in for it."""

from __future__ import annotations

import gtsam

from mqslam.config import GraphConfig
from mqslam.core.measurement import Measurement, Status
from mqslam.factors.noise import between_noise


def psi_between(a: int, b: int, motion: Measurement, config: GraphConfig) -> gtsam.BetweenFactorPose2:
    """Returns the factor of a front end's motion, with the covariance of its score's curvature and the settings' floor.

    Args:
        a: key of the pose at the motion's begin.
        b: key of the pose at its end.
        motion: the measurement.
        config: settings of the graph.
    """
    cancelling = config.cancelling if motion.status is Status.CONVERGED else 1.0
    covariance = motion.covariance / cancelling
    noise = between_noise(covariance, motion.pose[2], config.floor_m, config.floor_rad, config.huber)
    return gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(*motion.pose), noise)
