"""Noise models: covariances of relative motions as GTSAM takes them."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2

# Residual [standard deviations] beyond which the pull of a between-factor grows only linearly. Huber's loss then keeps 95 %
# of the efficiency of least squares where errors are Gaussian.
HUBER = 1.345
_LEAST = np.diag([1e-12, 1e-12, 1e-16])  # numerical: keeps a covariance without any error from being singular


def gaussian_noise(covariance: NDArray[np.float64], yaw: float) -> gtsam.noiseModel.Gaussian:
    """Returns the Gaussian noise of a between-factor.

    Args:
        covariance: (3, 3) of x, y, yaw of the motion, in the frame it starts in [m, m, rad].
        yaw: turn of the motion [rad]; GTSAM states errors in the frame that the motion ends in.
    """
    return gtsam.noiseModel.Gaussian.Covariance(se2.rotate_covariance(covariance, -yaw) + _LEAST)


def between_noise(covariance: NDArray[np.float64], yaw: float) -> gtsam.noiseModel.Base:
    """Returns the robust noise of a between-factor of successive poses.

    Args:
        covariance: (3, 3) as `gaussian_noise` takes it.
        yaw: turn of the motion [rad].
    """
    huber_loss = gtsam.noiseModel.mEstimator.Huber.Create(HUBER)
    return gtsam.noiseModel.Robust.Create(huber_loss, gaussian_noise(covariance, yaw))
