"""The between-factor of a loop closure: two passes of one place, with the covariance of their common score."""

from __future__ import annotations

from typing import Final

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.core.measurement import Loop
from mqslam.factors.noise import gaussian_noise

# Standard deviations of x, y [m] and yaw [rad] that are added to a loop's own: submaps bend, which their score does not
# show.
BEND_SIGMAS = (0.05, 0.05, 0.0015)
# The pull of a loop becomes weaker beyond this residual, in standard deviations.
CAUCHY: Final = 3.0


def add_bend(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the covariance (3, 3) [m, m, rad] of a loop with the bend of its submaps, which psi does not show."""
    return np.asarray(covariance + np.diag(np.square(BEND_SIGMAS)))


def loop_between(a: int, b: int, loop: Loop) -> gtsam.BetweenFactorPose2:
    """Returns the factor of a loop; a Cauchy weight keeps a wrong loop from bending the rest of the graph.

    Args:
        a: key of the earlier pose.
        b: key of the later pose.
        loop: the later pose in the frame of the earlier one, with its covariance.
    """
    gaussian = gaussian_noise(add_bend(loop.covariance), loop.pose[2])
    robust = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(CAUCHY), gaussian)
    return gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(*loop.pose), robust)
