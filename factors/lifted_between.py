"""The between-factor of a planar motion in a graph of spatial poses."""

from __future__ import annotations

import gtsam
import numpy as np

# Standard deviation [m] of z in a factor between poses in space, about which the radar says nothing: where a road bends, a
# vehicle leaves the plane in which it stands by no more within a submap.
_LIFTED_M = 0.1
# The same of roll and pitch [rad]: roads bend, and springs give way, by about as much within a submap.
_LIFTED_RAD = 0.03
_PLANAR = np.ix_([3, 4, 2], [3, 4, 2])  # x, y and yaw of a pose in space, whose errors are roll, pitch, yaw, x, y, z


def lifted_between(planar: gtsam.BetweenFactorPose2) -> gtsam.BetweenFactorPose3:
    """Returns the factor of a planar motion between two poses in space.

    Both poses are taken to lie in one plane, that of the first one, but for weak noise on z, roll and pitch. The loss stays
    the same.

    Args:
        planar: the factor of the motion between poses in the plane.
    """
    a, b = planar.keys()
    motion, noise = planar.measured(), planar.noiseModel()
    gaussian = noise.noise() if isinstance(noise, gtsam.noiseModel.Robust) else noise
    assert isinstance(gaussian, gtsam.noiseModel.Gaussian)
    covariance = np.diag(np.square([_LIFTED_RAD] * 3 + [_LIFTED_M] * 3))
    covariance[_PLANAR] = gaussian.covariance()
    spatial: gtsam.noiseModel.Base = gtsam.noiseModel.Gaussian.Covariance(covariance)
    if isinstance(noise, gtsam.noiseModel.Robust):
        spatial = gtsam.noiseModel.Robust.Create(noise.robust(), spatial)
    return gtsam.BetweenFactorPose3(a, b, gtsam.Pose3(motion), spatial)
