"""Noise models: covariances of relative motions as GTSAM takes them."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2


def between_noise(
    covariance: NDArray[np.float64], yaw: float, floor_m: float, floor_rad: float, huber: float
) -> gtsam.noiseModel.Base:
    """Robust noise of a between-factor.

    Args:
        covariance: (3, 3) of x, y, yaw of the motion, in the frame it starts in [m, m, rad].
        yaw: turn of the motion [rad]; GTSAM states errors in the frame the motion ends in.
        floor_m, floor_rad: least standard deviations, added in square: correlated errors that a covariance of its own
            data does not show.
        huber: residual beyond which the pull grows only linearly [sigma].
    """
    floor = np.diag([floor_m**2, floor_m**2, floor_rad**2])
    gaussian = gtsam.noiseModel.Gaussian.Covariance(se2.rotate_covariance(covariance, -yaw) + floor)
    return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(huber), gaussian)
