"""The between-factor of a loop closure: two passes of one place, with the covariance of their common score."""

from __future__ import annotations

import gtsam
import numpy as np

from mqslam.config import LoopConfig
from mqslam.core import se2
from mqslam.core.measurement import Loop


def loop_between(a: int, b: int, loop: Loop, config: LoopConfig) -> gtsam.BetweenFactorPose2:
    """The pose of key b in the frame of key a; a Cauchy weight keeps a wrong loop from bending the rest."""
    floor = np.diag([config.floor_m**2, config.floor_m**2, config.floor_rad**2])
    gaussian = gtsam.noiseModel.Gaussian.Covariance(se2.rotate_covariance(loop.covariance, -loop.pose[2]) + floor)
    robust = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(config.cauchy), gaussian)
    return gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(*loop.pose), robust)
