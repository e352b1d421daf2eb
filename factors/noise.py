"""Noise models: covariances of relative motions as GTSAM takes them."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2


def gaussian_noise(
    covariance: NDArray[np.float64], yaw: float, floor_m: float, floor_rad: float
) -> gtsam.noiseModel.Gaussian:
    """Returns the Gaussian noise of a between-factor.

    Args:
        covariance: (3, 3) of x, y, yaw of the motion, in the frame it starts in [m, m, rad].
        yaw: turn of the motion [rad]; GTSAM states errors in the frame that the motion ends in.
        floor_m: standard deviation of the position [m] that is added in square, for errors that edges share and that a
            covariance from one edge's own data does not show.
        floor_rad: the same for yaw [rad].
    """
    floor = np.diag([floor_m**2, floor_m**2, floor_rad**2])
    return gtsam.noiseModel.Gaussian.Covariance(se2.rotate_covariance(covariance, -yaw) + floor)


def between_noise(
    covariance: NDArray[np.float64], yaw: float, floor_m: float, floor_rad: float, huber: float
) -> gtsam.noiseModel.Base:
    """Returns the robust noise of a between-factor of successive poses.

    Args:
        covariance: (3, 3) as `gaussian_noise` takes it.
        yaw: turn of the motion [rad].
        floor_m: standard deviation of the position [m] that is added in square.
        floor_rad: the same for yaw [rad].
        huber: residual beyond which the pull of the factor grows only linearly [standard deviations].
    """
    gaussian = gaussian_noise(covariance, yaw, floor_m, floor_rad)
    return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(huber), gaussian)
