from __future__ import annotations

from collections.abc import Callable

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.factors.noise import HUBER, between_noise
from mqslam.factors.odometry_between import odometry_between
from mqslam.factors.prior import PRIOR_M, PRIOR_RAD, prior
from mqslam.factors.psi_between import psi_between

COVARIANCE = np.array([[0.04, 0.01, 0.002], [0.01, 0.01, -0.001], [0.002, -0.001, 0.0009]])
MOTION = Measurement(0.0, 0.25, np.array([3.0, 0.4, 1.1]), COVARIANCE)


def gaussian(factor: gtsam.BetweenFactorPose2) -> np.ndarray:
    return np.asarray(factor.noiseModel().noise().covariance())


def of_psi(a: int, b: int) -> gtsam.BetweenFactorPose2:
    return psi_between(a, b, MOTION.pose, MOTION.covariance)


def of_odometry(a: int, b: int) -> gtsam.BetweenFactorPose2:
    return odometry_between(a, b, MOTION)


@pytest.mark.parametrize("make", [of_psi, of_odometry])
def test_a_factor_holds_the_motion_between_its_keys(make: Callable[[int, int], gtsam.BetweenFactorPose2]) -> None:
    factor = make(X(4), X(5))
    assert list(factor.keys()) == [X(4), X(5)]
    measured = factor.measured()
    np.testing.assert_allclose([measured.x(), measured.y(), measured.theta()], MOTION.pose)
    start = np.array([10.0, -4.0, 2.0])
    values = gtsam.Values()
    values.insert(X(4), gtsam.Pose2(*start))
    values.insert(X(5), gtsam.Pose2(*se2.compose(start, MOTION.pose)))
    assert factor.error(values) == pytest.approx(0.0, abs=1e-15)


def test_the_noise_is_the_covariance_in_the_frame_in_which_gtsam_states_errors() -> None:
    """Poses drawn with the covariance have, in GTSAM's own errors, the covariance of the noise model."""
    rng = np.random.default_rng(3)
    small = 1e-6 * COVARIANCE  # where errors are linear
    draws = rng.multivariate_normal(np.zeros(3), small, 20000)
    truth = gtsam.Pose2(*MOTION.pose)
    local = np.array([truth.localCoordinates(gtsam.Pose2(*(MOTION.pose + d))) for d in draws])
    noise = between_noise(small, MOTION.pose[2])
    sampled, stated = np.cov(local.T), np.asarray(noise.noise().covariance())
    scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    np.testing.assert_allclose(sampled / scale, stated / scale, atol=0.04)


@pytest.mark.parametrize("make", [of_psi, of_odometry])
def test_the_noise_is_the_covariance_of_the_measurement_and_nothing_else(
    make: Callable[[int, int], gtsam.BetweenFactorPose2],
) -> None:
    np.testing.assert_allclose(se2.rotate_covariance(gaussian(make(X(0), X(1))), MOTION.pose[2]), COVARIANCE, atol=1e-9)


def test_a_residual_beyond_huber_pulls_only_linearly() -> None:
    factor = psi_between(X(0), X(1), np.zeros(3), np.eye(3))

    def error(x: float) -> float:
        values = gtsam.Values()
        values.insert(X(0), gtsam.Pose2())
        values.insert(X(1), gtsam.Pose2(x, 0.0, 0.0))
        return float(factor.error(values))

    assert error(1.0) == pytest.approx(0.5)
    assert error(12.0) - error(11.0) == pytest.approx(HUBER, rel=1e-6)


def test_the_prior_holds_the_pose_it_is_given() -> None:
    factor = prior(X(0), np.array([1.0, 2.0, 0.3]))
    at = factor.prior()
    np.testing.assert_allclose([at.x(), at.y(), at.theta()], [1.0, 2.0, 0.3])
    np.testing.assert_allclose(factor.noiseModel().sigmas(), [PRIOR_M, PRIOR_M, PRIOR_RAD])
