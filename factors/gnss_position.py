"""The factor of a position on the Earth: where a pose lies in a tangent plane, whose own pose in the map is a variable."""

from __future__ import annotations

from typing import Final

import gtsam
import numpy as np

from mqslam.core import se2

# Residual beyond which a fix is a jump and hardly counts [standard deviations].
REACH = 3.0
_NO_TURN: Final = 1e-6  # numerical: the plane wanders and does not turn [rad]
_UNKNOWN_YAW: Final = 1e3  # a fix says nothing of the yaw: far more than a turn [rad]


def gnss_position(plane: int, key: int, pose: se2.Array, sigma_m: float) -> gtsam.BetweenFactorPose2:
    """Returns the factor of a fix; one that jumps away hardly pulls (Geman and McClure's weights).

    Args:
        plane: key of the tangent plane's pose in the map (Pose2).
        key: of the pose that was fixed (Pose2).
        pose: (3,) of it in the tangent plane: the position that was fixed [m], and about its yaw [rad].
        sigma_m: standard deviation along each axis [m].
    """
    sigmas = gtsam.noiseModel.Diagonal.Sigmas(np.array([sigma_m, sigma_m, _UNKNOWN_YAW]))
    robust = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.GemanMcClure.Create(REACH), sigmas)
    return gtsam.BetweenFactorPose2(plane, key, gtsam.Pose2(*pose), robust)


def plane_walk(a: int, b: int, walk_m: float) -> gtsam.BetweenFactorPose2:
    """Returns the factor of two successive poses of the tangent plane: a receiver's error wanders, and so does its plane.

    Args:
        a: key of the earlier pose (Pose2).
        b: key of the later one.
        walk_m: standard deviation along each axis [m].
    """
    sigmas = gtsam.noiseModel.Diagonal.Sigmas(np.array([walk_m, walk_m, _NO_TURN]))
    return gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(), sigmas)
