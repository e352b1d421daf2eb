"""A between-factor holds the measured pose and its covariance, with a loss that keeps a wrong one from bending the graph."""

from __future__ import annotations

from collections.abc import Callable

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from mqslam.core import se2
from mqslam.core.measurement import Loop
from mqslam.factors import between
from mqslam.factors.between import CAUCHY, HUBER, PRIOR_M, PRIOR_RAD, lifted_between, loop_between, prior, psi_between

COVARIANCE = np.array([[0.04, 0.01, 0.002], [0.01, 0.01, -0.001], [0.002, -0.001, 0.0009]])
POSE = np.array([3.0, 0.4, 1.1])
FLAT = (1e-9, 1e-9, 1e-9)
"""Hardly any bend of submaps [m, m, rad]."""
Make = Callable[[np.ndarray, np.ndarray], gtsam.BetweenFactorPose2]


def of_psi(pose: np.ndarray, covariance: np.ndarray) -> gtsam.BetweenFactorPose2:
    return psi_between(X(3), X(40), pose, covariance)


def of_loop(pose: np.ndarray, covariance: np.ndarray) -> gtsam.BetweenFactorPose2:
    return loop_between(X(3), X(40), Loop(3, 40, pose, covariance, 0.8, 0.2))


def gaussian(factor: gtsam.BetweenFactorPose2) -> np.ndarray:
    return np.asarray(factor.noiseModel().noise().covariance())


def error(
    factor: gtsam.NonlinearFactor, pose: np.ndarray | gtsam.Pose3, start: tuple[float, ...] = (10.0, -4.0, 2.0)
) -> float:
    """Returns the error of a factor, of either kind, whose second pose is (3,) or in space in the frame of the first."""
    begin, moved = (
        gtsam.Pose3(gtsam.Pose2(*start)),
        pose if isinstance(pose, gtsam.Pose3) else gtsam.Pose3(gtsam.Pose2(*pose)),
    )
    values = gtsam.Values()
    for key, at in zip(factor.keys(), (begin, begin.compose(moved)), strict=True):
        is_planar = isinstance(factor, gtsam.BetweenFactorPose2)
        values.insert(key, gtsam.Pose2(at.x(), at.y(), at.rotation().yaw()) if is_planar else at)
    return float(factor.error(values))


@pytest.mark.parametrize("make", [of_psi, of_loop])
def test_a_factor_holds_the_later_pose_in_the_frame_of_the_earlier(make: Make) -> None:
    factor = make(POSE, COVARIANCE)
    assert list(factor.keys()) == [X(3), X(40)]
    measured = factor.measured()
    np.testing.assert_allclose([measured.x(), measured.y(), measured.theta()], POSE)
    assert error(factor, POSE) == pytest.approx(0.0, abs=1e-12)
    assert error(factor, se2.inverse(POSE)) > 1.0


@pytest.mark.parametrize("make", [of_psi, of_loop])
def test_the_noise_is_the_covariance_in_the_frame_in_which_gtsam_states_errors(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Poses drawn with the covariance have, in GTSAM's own errors, the covariance of the noise model."""
    monkeypatch.setattr(between, "BEND_SIGMAS", FLAT)
    rng = np.random.default_rng(3)
    small = 1e-6 * COVARIANCE  # where errors are linear
    draws = rng.multivariate_normal(np.zeros(3), small, 20000)
    truth = gtsam.Pose2(*POSE)
    local = np.array([truth.localCoordinates(gtsam.Pose2(*(POSE + d))) for d in draws])
    sampled, stated = np.cov(local.T), gaussian(make(POSE, small))
    scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    np.testing.assert_allclose(sampled / scale, stated / scale, atol=0.04)
    np.testing.assert_allclose(se2.rotate_covariance(gaussian(make(POSE, COVARIANCE)), POSE[2]), COVARIANCE, atol=1e-9)


def test_the_bend_of_submaps_is_added_to_a_loop_alike_in_every_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    covariances = []
    for sigmas in ((0.3, 0.3, 0.02), FLAT):
        monkeypatch.setattr(between, "BEND_SIGMAS", sigmas)
        covariances.append(gaussian(of_loop(POSE, COVARIANCE)))
    np.testing.assert_allclose(covariances[0] - covariances[1], np.diag([0.09, 0.09, 0.0004]), atol=1e-12)


def test_a_residual_beyond_huber_pulls_only_linearly() -> None:
    factor = of_psi(np.zeros(3), np.eye(3))
    near, far, farther = (error(factor, np.array([x, 0.0, 0.0])) for x in (1.0, 11.0, 12.0))
    assert near == pytest.approx(0.5)
    assert farther - far == pytest.approx(HUBER, rel=1e-6)


def test_a_residual_of_a_loop_far_off_pulls_less_than_a_moderate_one() -> None:
    """Cauchy: at the residual CAUCHY the pull is at its greatest, and it vanishes far out; Huber's never does."""
    factor = of_loop(POSE, np.eye(3))
    sigma, (c, s) = np.sqrt(gaussian(factor)[0, 0]), (np.cos(POSE[2]), np.sin(POSE[2]))

    def pull(residual: float) -> float:
        """Returns the derivative of the error by the residual [1 / sigma]."""
        ahead = sigma * np.array([c, s, 0.0])  # one sigma along x of the frame in which errors are stated
        beyond, before = (error(factor, POSE + (residual + d) * ahead) for d in (1e-4, -1e-4))
        return (beyond - before) / 2e-4

    for residual in (0.5, CAUCHY, 30.0):
        assert pull(residual) == pytest.approx(residual / (1.0 + (residual / CAUCHY) ** 2), rel=1e-3)
    assert pull(30.0) < 0.3 * pull(CAUCHY)


@pytest.mark.parametrize("off", [(1e-3, 0.0, 0.0), (0.0, -2e-3, 0.0), (0.0, 0.0, 1e-3), (2e-3, 1e-3, -1e-3)])
def test_a_planar_error_costs_in_space_what_it_costs_in_the_plane(off: tuple[float, float, float]) -> None:
    planar = of_psi(POSE, COVARIANCE)
    known = error(planar, POSE + off)
    assert known > 0.0
    assert error(lifted_between(planar), POSE + off) == pytest.approx(known, rel=1e-3)


def test_height_and_tilt_are_held_weakly() -> None:
    lifted = lifted_between(of_psi(POSE, COVARIANCE))
    assert list(lifted.keys()) == [X(3), X(40)]
    end = gtsam.Pose3(gtsam.Pose2(*POSE))
    for off, sigma in (((0, 0, 0, 0, 0, 0.04), 0.1), ((0.02, 0, 0, 0, 0, 0), 0.03), ((0, 0.02, 0, 0, 0, 0), 0.03)):
        moved = error(lifted, end.retract(np.array(off)), (0.0, 0.0, 0.0))
        assert moved == pytest.approx(0.5 * (max(off) / sigma) ** 2, rel=1e-3)


def test_a_factor_in_space_keeps_the_loss() -> None:
    far = np.array([8.0, 0.4, 1.1])
    for planar in (of_psi(POSE, COVARIANCE), of_loop(POSE, COVARIANCE)):
        assert error(lifted_between(planar), far) == pytest.approx(error(planar, far), rel=1e-6)
    plain = gtsam.BetweenFactorPose2(X(1), X(2), gtsam.Pose2(*POSE), gtsam.noiseModel.Isotropic.Sigma(3, 0.1))
    assert not isinstance(lifted_between(plain).noiseModel(), gtsam.noiseModel.Robust)


def test_the_prior_holds_the_pose_it_is_given() -> None:
    factor = prior(X(0), np.array([1.0, 2.0, 0.3]))
    at = factor.prior()
    np.testing.assert_allclose([at.x(), at.y(), at.theta()], [1.0, 2.0, 0.3])
    np.testing.assert_allclose(factor.noiseModel().sigmas(), [PRIOR_M, PRIOR_M, PRIOR_RAD])
