"""The prior that ties the first pose of a graph to the origin."""

from __future__ import annotations

import gtsam
import numpy as np

from mqslam.config import GraphConfig
from mqslam.core import se2


def prior(key: int, pose: se2.Array, config: GraphConfig) -> gtsam.PriorFactorPose2:
    """Returns the factor that holds the pose of a key where it is.

    Args:
        key: of the pose.
        pose: (3,) x [m], y [m], yaw [rad].
        config: settings of the graph.
    """
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([config.prior_m, config.prior_m, config.prior_rad]))
    return gtsam.PriorFactorPose2(key, gtsam.Pose2(*pose), noise)
