"""A loop becomes a between-factor of its own pose and covariance, robust against being wrong."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from mqslam.core import se2
from mqslam.core.measurement import Loop
from mqslam.factors import loop_between as module
from mqslam.factors.loop_between import CAUCHY, loop_between

COVARIANCE = np.array([[0.04, 0.01, 0.002], [0.01, 0.01, -0.001], [0.002, -0.001, 0.0009]])
LOOP = Loop(3, 40, np.array([2.0, -1.5, 3.0]), COVARIANCE, 0.8, 0.2)
FLAT = (1e-9, 1e-9, 1e-9)
"""Hardly any bend of submaps [m, m, rad]."""


def gaussian(factor: gtsam.BetweenFactorPose2) -> np.ndarray:
    return np.asarray(factor.noiseModel().noise().covariance())


def error(factor: gtsam.BetweenFactorPose2, measured: np.ndarray) -> float:
    """Returns the factor's error where key b lies at a pose (3,) in the frame of key a."""
    start = np.array([10.0, -4.0, 2.0])
    values = gtsam.Values()
    values.insert(X(3), gtsam.Pose2(*start))
    values.insert(X(40), gtsam.Pose2(*se2.compose(start, measured)))
    return float(factor.error(values))


def test_the_factor_holds_the_later_pose_in_the_frame_of_the_earlier() -> None:
    factor = loop_between(X(3), X(40), LOOP)
    assert list(factor.keys()) == [X(3), X(40)]
    z = factor.measured()
    np.testing.assert_allclose([z.x(), z.y(), z.theta()], LOOP.pose)
    assert error(factor, LOOP.pose) == pytest.approx(0.0, abs=1e-12)
    assert error(factor, se2.inverse(LOOP.pose)) > 1.0


def test_the_noise_is_the_covariance_in_the_frame_in_which_gtsam_states_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "BEND_SIGMAS", FLAT)
    rng = np.random.default_rng(3)
    draws = rng.multivariate_normal(np.zeros(3), 1e-6 * COVARIANCE, 20000)
    truth = gtsam.Pose2(*LOOP.pose)
    local = np.array([truth.localCoordinates(gtsam.Pose2(*(LOOP.pose + d))) for d in draws])
    sampled, stated = 1e6 * np.cov(local.T), gaussian(loop_between(X(3), X(40), LOOP))
    scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    np.testing.assert_allclose(sampled / scale, stated / scale, atol=0.04)


def test_the_floor_is_added_in_square_and_alike_in_every_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    covariances = []
    for sigmas in ((0.3, 0.3, 0.02), FLAT):
        monkeypatch.setattr(module, "BEND_SIGMAS", sigmas)
        covariances.append(gaussian(loop_between(X(3), X(40), LOOP)))
    np.testing.assert_allclose(covariances[0] - covariances[1], np.diag([0.09, 0.09, 0.0004]), atol=1e-12)


def test_a_residual_far_off_pulls_less_than_a_moderate_one() -> None:
    """Cauchy: at the residual CAUCHY the pull is at its greatest, and it vanishes far out; Huber's never does."""
    loop = Loop(3, 40, LOOP.pose, np.diag([1.0, 1.0, 1.0]), 0.8, 0.2)
    factor = loop_between(X(3), X(40), loop)
    sigma = np.sqrt(gaussian(factor)[0, 0])
    c, s = np.cos(loop.pose[2]), np.sin(loop.pose[2])

    def pull(residual: float) -> float:
        """Returns the derivative of the error by the residual [1 / sigma]."""
        ahead = sigma * np.array([c, s, 0.0])  # one sigma along x of the frame in which errors are stated
        beyond, before = (error(factor, loop.pose + (residual + d) * ahead) for d in (1e-4, -1e-4))
        return (beyond - before) / 2e-4

    for residual in (0.5, CAUCHY, 30.0):
        assert pull(residual) == pytest.approx(residual / (1.0 + (residual / CAUCHY) ** 2), rel=1e-3)
    assert pull(30.0) < 0.3 * pull(CAUCHY)
