"""The between-factor of a loop closure: two passes of one place, with the covariance of their common score."""

from __future__ import annotations

import gtsam
import numpy as np

from mqslam.config import LoopConfig
from mqslam.core.measurement import Loop
from mqslam.factors.noise import gaussian_noise


def loop_between(a: int, b: int, loop: Loop, config: LoopConfig) -> gtsam.BetweenFactorPose2:
    """Returns the factor of a loop; a Cauchy weight keeps a wrong loop from bending the rest of the graph.

    Args:
        a: key of the earlier pose.
        b: key of the later pose.
        loop: the later pose in the frame of the earlier one, with its covariance.
        config: settings of loops.
    """
    bent = np.diag([config.floor_m**2, config.floor_m**2, config.floor_rad**2])  # submaps bend, which psi does not show
    gaussian = gaussian_noise(loop.covariance + bent, loop.pose[2])
    robust = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(config.cauchy), gaussian)
    return gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(*loop.pose), robust)
