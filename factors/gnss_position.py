"""Factors of GNSS fixes: positions in a tangent plane of the Earth; the plane's pose in the map is a graph variable."""

from __future__ import annotations

from typing import Final

import gtsam
import numpy as np

from mqslam.core import se2

# Residual of a fix [standard deviations] beyond which the fix counts as a jump and gets very little weight.
REACH = 3.0
_NO_TURN: Final = 1e-6  # numerical: standard deviation of the yaw of a plane that does not rotate [rad]
_UNKNOWN_YAW: Final = 1e3  # standard deviation of a yaw that is not measured [rad]: far more than a full rotation


def gnss_position(plane: int, key: int, pose: se2.Array, sigma_m: float) -> gtsam.BetweenFactorPose2:
    """Returns the factor of a fix, with the loss of Geman and McClure: a fix that jumps away gets very little weight.

    Args:
        plane: key of the tangent plane's pose in the map (Pose2).
        key: key of the pose whose position the fix measures (Pose2).
        pose: (3,) this pose in the tangent plane: measured position east, north [m], and approximate yaw [rad].
        sigma_m: standard deviation of the fix along each axis [m].
    """
    sigmas = gtsam.noiseModel.Diagonal.Sigmas(np.array([sigma_m, sigma_m, _UNKNOWN_YAW]))
    robust = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.GemanMcClure.Create(REACH), sigmas)
    return gtsam.BetweenFactorPose2(plane, key, gtsam.Pose2(*pose), robust)


def plane_walk(a: int, b: int, walk_m: float) -> gtsam.BetweenFactorPose2:
    """Returns the factor between two successive poses of the tangent plane, which drifts like the receiver's error.

    Args:
        a: key of the earlier pose (Pose2).
        b: key of the later pose (Pose2).
        walk_m: standard deviation of the drift from the earlier to the later pose along each axis [m].
    """
    sigmas = gtsam.noiseModel.Diagonal.Sigmas(np.array([walk_m, walk_m, _NO_TURN]))
    return gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(), sigmas)
