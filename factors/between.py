"""Factors between planar poses, with the noise and robust loss of each kind of measurement, and the first pose's prior.

The submaps of a loop are bent if the trajectory along which they are rendered is wrong within the submaps.
"""

from __future__ import annotations

from typing import Final

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2, units
from mqslam.core.measurement import Loop

# Residual of a motion [standard deviations] beyond which Huber's loss grows only linearly. With this value the loss keeps
# 95 % of the efficiency of least squares where errors are Gaussian.
HUBER: Final = 1.345
# Residual of a loop [standard deviations] at which Cauchy's loss halves the weight of the loop.
CAUCHY: Final = 3.0
# Standard deviations of the error of a loop in x, y [m] and yaw [rad] that slightly bent submaps cause. Their squares are
# added to the covariance of the loop, because psi does not show this error.
BEND_SIGMAS = (0.05, 0.05, 0.0015)
# Standard deviations [m, rad] of the prior that holds the first pose: far smaller than the uncertainty of any motion.
PRIOR_M, PRIOR_RAD = 1e-3, 1e-4
# Standard deviations of z [m], and of roll and pitch [rad], in a factor between poses in space. The radar does not measure
# these components; within a submap, roads bend and springs give way by no more than this.
_LIFTED_M, _LIFTED_RAD = 0.1, 0.03

_LEAST: Final = np.diag([1e-12, 1e-12, 1e-16])  # numerical: without it, the covariance of an exact motion would be singular
_PLANAR: Final = np.ix_([3, 4, 2], [3, 4, 2])  # x, y and yaw among the errors of a pose in space: roll, pitch, yaw, x, y, z
_LOSSES: Final = gtsam.noiseModel.mEstimator


def psi_between(a: int, b: int, pose: se2.Array, covariance: NDArray[np.float64]) -> gtsam.BetweenFactorPose2:
    """Returns the between-factor of a relative pose measured by psi, another front end or odometry, with Huber's loss.

    Args:
        a: key of the pose in whose frame the other is measured: an earlier scan or a submap.
        b: key of the pose that is measured: a later scan or submap.
        pose: (3,) pose of b in the frame of a [m, m, rad].
        covariance: (3, 3) covariance of this pose, in the frame of a [m, m, rad].
    """
    return _make_between(a, b, pose, covariance, _LOSSES.Huber.Create(HUBER))


def loop_between(a: int, b: int, loop: Loop) -> gtsam.BetweenFactorPose2:
    """Returns the between-factor of a loop, with Cauchy's loss, so that a wrong loop hardly changes the rest of the graph.

    Args:
        a: key of the earlier pose.
        b: key of the later pose.
        loop: the later pose in the frame of the earlier pose, with its covariance, which `add_bend` enlarges.
    """
    return _make_between(a, b, loop.pose, add_bend(loop.covariance), _LOSSES.Cauchy.Create(CAUCHY))


def add_bend(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns a loop's covariance (3, 3) [m, m, rad] plus the covariance from bent submaps, which psi does not show."""
    return np.asarray(covariance + np.diag(np.square(BEND_SIGMAS)))


def _make_between(
    a: int, b: int, pose: se2.Array, covariance: NDArray[np.float64], loss: gtsam.noiseModel.mEstimator.Base
) -> gtsam.BetweenFactorPose2:
    """Returns a between-factor from a pose and covariance in the frame of a; GTSAM takes covariances in the frame of b."""
    gaussian = gtsam.noiseModel.Gaussian.Covariance(se2.rotate_covariance(covariance, -pose[2]) + _LEAST)
    return gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(*pose), gtsam.noiseModel.Robust.Create(loss, gaussian))


def lifted_between(planar: gtsam.BetweenFactorPose2) -> gtsam.BetweenFactorPose3:
    """Converts the factor of a planar motion to a factor between two poses in space, with the same loss.

    Both poses are taken to lie in the plane of the first pose; the noise on z, roll and pitch allows small deviations.
    """
    a, b = planar.keys()
    covariance = np.diag(np.square([_LIFTED_RAD] * 3 + [_LIFTED_M] * 3))
    covariance[_PLANAR] = _find_gaussian(planar.noiseModel()).covariance()
    noise = _replace_covariance(planar.noiseModel(), covariance)
    return gtsam.BetweenFactorPose3(a, b, gtsam.Pose3(planar.measured()), noise)


def _find_gaussian(noise: gtsam.noiseModel.Base) -> gtsam.noiseModel.Gaussian:
    """Returns the Gaussian noise of a noise model with or without a robust loss."""
    gaussian = noise.noise() if isinstance(noise, gtsam.noiseModel.Robust) else noise
    assert isinstance(gaussian, gtsam.noiseModel.Gaussian)
    return gaussian


def _replace_covariance(noise: gtsam.noiseModel.Base, covariance: NDArray[np.float64]) -> gtsam.noiseModel.Base:
    """Returns a noise model with another covariance (3, 3) or (6, 6), and with the robust loss of `noise`, if any."""
    gaussian = gtsam.noiseModel.Gaussian.Covariance(covariance)
    if isinstance(noise, gtsam.noiseModel.Robust):
        return gtsam.noiseModel.Robust.Create(noise.robust(), gaussian)
    return gaussian


def prior(key: int, pose: se2.Array) -> gtsam.PriorFactorPose2:
    """Returns the prior factor that holds the variable of a key at a pose (3,) [m, m, rad]."""
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([PRIOR_M, PRIOR_M, PRIOR_RAD]))
    return gtsam.PriorFactorPose2(key, gtsam.Pose2(*pose), noise)


def _find_loop_noise(factor: gtsam.NonlinearFactor) -> gtsam.noiseModel.Gaussian | None:
    """Returns the Gaussian noise of a loop, which is a planar between-factor with Cauchy's loss; None for other factors."""
    noise = factor.noiseModel() if isinstance(factor, gtsam.BetweenFactorPose2) else None
    if isinstance(noise, gtsam.noiseModel.Robust) and isinstance(noise.robust(), _LOSSES.Cauchy):
        return _find_gaussian(noise)
    return None


def measure_loop_offset(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> float:
    """Returns the residual of a loop at the values of its poses [standard deviations]; zero for any other factor."""
    gaussian = _find_loop_noise(factor)
    if gaussian is None:
        return 0.0
    assert isinstance(factor, gtsam.BetweenFactorPose2)
    return float(np.linalg.norm(gaussian.whiten(factor.unwhitenedError(values))))


def hold_firmly(factor: gtsam.NonlinearFactor) -> gtsam.NonlinearFactor:
    """Replaces the Cauchy loss of a loop by Huber's loss, which cannot ignore the loop; returns other factors unchanged."""
    gaussian = _find_loop_noise(factor)
    if gaussian is None:
        return factor
    assert isinstance(factor, gtsam.BetweenFactorPose2)
    a, b = factor.keys()
    return gtsam.BetweenFactorPose2(
        a, b, factor.measured(), gtsam.noiseModel.Robust.Create(_LOSSES.Huber.Create(HUBER), gaussian)
    )


def scale_factors(factors: gtsam.NonlinearFactorGraph, scale: float) -> gtsam.NonlinearFactorGraph:
    """Returns between-factors and priors of planar poses with all lengths multiplied by a scale.

    The noise is scaled, too, so that the weights of errors stay the same.

    Raises:
        TypeError: a factor is of another type, which the error names.
    """
    scaled = gtsam.NonlinearFactorGraph()
    for k in range(factors.size()):
        factor = factors.at(k)
        if isinstance(factor, gtsam.PriorFactorPose2):
            pose, noise = scale_vector(factor.prior(), scale), _scale_noise(factor.noiseModel(), scale)
            scaled.push_back(gtsam.PriorFactorPose2(factor.keys()[0], gtsam.Pose2(*pose), noise))
        elif isinstance(factor, gtsam.BetweenFactorPose2):
            scaled.push_back(scale_between(factor, scale))
        else:
            raise TypeError(f"a {type(factor).__name__}")
    return scaled


def scale_between(factor: gtsam.BetweenFactorPose2, scale: float) -> gtsam.BetweenFactorPose2:
    """Returns a between-factor of planar poses with the lengths of motion and noise multiplied by a scale."""
    a, b = factor.keys()
    noise = _scale_noise(factor.noiseModel(), scale)
    return gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(*scale_vector(factor.measured(), scale)), noise)


def _scale_noise(noise: gtsam.noiseModel.Base, scale: float) -> gtsam.noiseModel.Base:
    """Returns the noise model of a planar pose with lengths multiplied by a scale; a robust loss stays the same."""
    return _replace_covariance(noise, units.scale_covariance(_find_gaussian(noise).covariance(), scale))


def scale_vector(pose: gtsam.Pose2, scale: float) -> se2.Array:
    """Returns a pose as an array (3,) x, y, yaw [rad], with x and y multiplied by a scale."""
    return np.array([scale * pose.x(), scale * pose.y(), pose.theta()])
