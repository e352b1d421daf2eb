"""The prior that ties the first pose of a graph to the origin."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

SIGMA_M = 1e-3
SIGMA_RAD = 1e-4


def prior(key: int, pose: NDArray[np.float64]) -> gtsam.PriorFactorPose2:
    """Hold the pose of a key at (3,) x [m], y [m], yaw [rad]."""
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([SIGMA_M, SIGMA_M, SIGMA_RAD]))
    return gtsam.PriorFactorPose2(key, gtsam.Pose2(*pose), noise)
