"""The between-factor of a pose that psi has measured, in its front end or in the refinement, or another front end."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.factors.noise import between_noise


def psi_between(a: int, b: int, pose: se2.Array, covariance: NDArray[np.float64]) -> gtsam.BetweenFactorPose2:
    """Returns the factor of a measured relative pose: of a scan in its submap, or of a scan in another's frame.

    Args:
        a: key of the submap or of the earlier scan.
        b: key of the later scan or submap.
        pose: (3,) of b in the frame of a [m, m, rad].
        covariance: (3, 3) of it, in the frame of a, as the score's curvature gives it.
    """
    return gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(*pose), between_noise(covariance, pose[2]))
