"""The between-factor of the refinement: a scan in the frame of an earlier pass's nearest scan."""

from __future__ import annotations

import gtsam

from mqslam.config import GraphConfig
from mqslam.core.measurement import Loop
from mqslam.factors.noise import between_noise


def refinement_between(a: int, b: int, tie: Loop, config: GraphConfig) -> gtsam.BetweenFactorPose2:
    """Returns the factor of a scan that psi has laid into earlier passes.

    Args:
        a: key of the nearest scan of an earlier pass.
        b: key of the scan that was measured.
        tie: the measured scan in the frame of the other one, with its covariance.
        config: settings of the graph.
    """
    noise = between_noise(tie.covariance, tie.pose[2], config.huber)
    return gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(*tie.pose), noise)
