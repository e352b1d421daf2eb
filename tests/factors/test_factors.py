from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from mqslam.config import GraphConfig
from mqslam.core import se2
from mqslam.core.measurement import Measurement, Status
from mqslam.factors.noise import between_noise
from mqslam.factors.odometry_between import estimate_odometry_covariance, odometry_between
from mqslam.factors.prior import prior
from mqslam.factors.psi_between import psi_between

DEFAULT = GraphConfig()
COVARIANCE = np.array([[0.04, 0.01, 0.002], [0.01, 0.01, -0.001], [0.002, -0.001, 0.0009]])
MOTION = Measurement(0.0, 0.25, np.array([3.0, 0.4, 1.1]), COVARIANCE)


def gaussian(factor: gtsam.BetweenFactorPose2) -> np.ndarray:
    return np.asarray(factor.noiseModel().noise().covariance())


def of_psi(a: int, b: int) -> gtsam.BetweenFactorPose2:
    return psi_between(a, b, MOTION.pose, MOTION.covariance, DEFAULT)


def of_odometry(a: int, b: int) -> gtsam.BetweenFactorPose2:
    return odometry_between(a, b, MOTION, DEFAULT)


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
    noise = between_noise(small, MOTION.pose[2], 1.345)
    sampled, stated = np.cov(local.T), np.asarray(noise.noise().covariance())
    scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    np.testing.assert_allclose(sampled / scale, stated / scale, atol=0.04)


@pytest.mark.parametrize("make", [of_psi, of_odometry])
def test_the_noise_is_the_covariance_of_the_measurement_and_nothing_else(
    make: Callable[[int, int], gtsam.BetweenFactorPose2],
) -> None:
    np.testing.assert_allclose(se2.rotate_covariance(gaussian(make(X(0), X(1))), MOTION.pose[2]), COVARIANCE, atol=1e-9)


def test_a_residual_beyond_huber_pulls_only_linearly() -> None:
    factor = psi_between(X(0), X(1), np.zeros(3), np.eye(3), DEFAULT)

    def error(x: float) -> float:
        values = gtsam.Values()
        values.insert(X(0), gtsam.Pose2())
        values.insert(X(1), gtsam.Pose2(x, 0.0, 0.0))
        return float(factor.error(values))

    assert error(1.0) == pytest.approx(0.5)
    assert error(12.0) - error(11.0) == pytest.approx(DEFAULT.huber, rel=1e-6)


def test_the_prior_holds_the_pose_it_is_given() -> None:
    factor = prior(X(0), np.array([1.0, 2.0, 0.3]), DEFAULT)
    at = factor.prior()
    np.testing.assert_allclose([at.x(), at.y(), at.theta()], [1.0, 2.0, 0.3])
    np.testing.assert_allclose(factor.noiseModel().sigmas(), [DEFAULT.prior_m, DEFAULT.prior_m, DEFAULT.prior_rad])


def run(poses: np.ndarray) -> list[Measurement]:
    return [Measurement(0.25 * k, 0.25 * (k + 1), pose, COVARIANCE) for k, pose in enumerate(poses)]


def straight(count: int = 200) -> np.ndarray:
    return np.tile([2.0, 0.0, 0.0], (count, 1))


def test_odometry_noise_grows_with_its_bias() -> None:
    measured = run(straight())
    sigmas = []
    for bias in (0.0, 0.001, 0.003):
        odometry = run(straight() + np.array([0.0, 0.0, bias]))
        covariance = estimate_odometry_covariance(odometry, measured, DEFAULT)
        np.testing.assert_allclose(covariance, np.diag(np.diag(covariance)))
        sigmas.append(np.sqrt(np.diag(covariance)))
    assert sigmas[0][2] < 1e-4 < sigmas[1][2] < sigmas[2][2]
    # forty edges a span, each with the variance of the span's whole disagreement, 40 * bias, times the spans of the run
    assert sigmas[1][2] == pytest.approx(40 * 0.001 * np.sqrt(len(measured) / 40) / np.sqrt(0.4549), rel=1e-2)


def test_odometry_of_a_long_run_weighs_no_more_in_all_than_that_of_one_span() -> None:
    rng = np.random.default_rng(8)
    noise = rng.normal(0.0, [0.05, 0.02, 1e-4], (4000, 3))
    covariance = estimate_odometry_covariance(run(straight(4000) + noise), run(straight(4000)), DEFAULT)
    # 40 edges a span, 100 spans
    assert np.sqrt(covariance[0, 0]) == pytest.approx(0.05 * np.sqrt(40 * 100), rel=0.25)
    assert np.sqrt(covariance[2, 2]) == pytest.approx(1e-4 * np.sqrt(40 * 100), rel=0.25)


def test_a_few_wild_spans_do_not_set_the_noise() -> None:
    wild = straight(400)
    wild[100] = [2.0, 0.0, 2.0]
    few = estimate_odometry_covariance(run(wild), run(straight(400)), DEFAULT)
    np.testing.assert_allclose(few, estimate_odometry_covariance(run(straight(400)), run(straight(400)), DEFAULT))


@pytest.mark.parametrize("span_s", [0.01, 10.0, 1e6])
def test_the_span_may_be_shorter_than_an_edge_or_longer_than_the_run(span_s: float) -> None:
    covariance = estimate_odometry_covariance(
        run(straight(7) + np.array([0.1, 0.0, 0.0])), run(straight(7)), GraphConfig(odometry_span_s=span_s)
    )
    np.testing.assert_array_less(0.0, np.diag(covariance))


def test_a_short_run_does_not_make_odometry_better_than_it_says_itself() -> None:
    agreeing = estimate_odometry_covariance(run(straight(30)), run(straight(30)), DEFAULT)
    np.testing.assert_allclose(np.diag(agreeing), 30**2 * np.diag(COVARIANCE), rtol=1e-6)


@pytest.mark.parametrize("status", [Status.LOST, Status.DEGENERATE])
def test_motions_that_psi_took_from_odometry_do_not_vouch_for_it(status: Status) -> None:
    odometry, measured = run(straight(400) + np.array([0.1, 0.0, 0.0])), run(straight(400))
    alone = np.sqrt(estimate_odometry_covariance(odometry, measured, DEFAULT)[0, 0])
    for k in range(0, 400, 4):
        measured[k] = replace(odometry[k], status=status)
    assert np.sqrt(estimate_odometry_covariance(odometry, measured, DEFAULT)[0, 0]) == pytest.approx(alone, rel=0.05)
    tunnel = [replace(motion, status=status) for motion in odometry]
    assert np.sqrt(estimate_odometry_covariance(odometry, tunnel, DEFAULT)[0, 0]) > alone
