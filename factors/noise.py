"""Noise models: covariances of relative motions as GTSAM takes them."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray


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
    gaussian = gtsam.noiseModel.Gaussian.Covariance(rotated_to_end(covariance, yaw) + floor)
    return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(huber), gaussian)


def rotated_to_end(covariance: NDArray[np.float64], yaw: float) -> NDArray[np.float64]:
    """A motion's covariance (3, 3), given in the frame it starts in, in the frame it ends in, turned by yaw [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    to_end = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    local = to_end @ covariance @ to_end.T
    return np.asarray(0.5 * (local + local.T))
