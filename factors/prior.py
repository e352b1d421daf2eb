"""The prior that ties the first pose of a graph to the origin."""

from __future__ import annotations

import gtsam
import numpy as np

from mqslam.core import se2

# Standard deviation [m] of the prior that holds the first pose at the origin: far below what any motion is known to.
PRIOR_M = 1e-3
# Standard deviation [rad] of the prior that holds the first yaw at zero.
PRIOR_RAD = 1e-4


def prior(key: int, pose: se2.Array) -> gtsam.PriorFactorPose2:
    """Returns the factor that holds the pose of a key where it is.

    Args:
        key: of the pose.
        pose: (3,) x [m], y [m], yaw [rad].
    """
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([PRIOR_M, PRIOR_M, PRIOR_RAD]))
    return gtsam.PriorFactorPose2(key, gtsam.Pose2(*pose), noise)
