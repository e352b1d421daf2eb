"""A planar factor between poses in space says the same of x, y and yaw, and next to nothing of the rest."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from mqslam.core.measurement import Loop
from mqslam.factors.lifted_between import lifted_between
from mqslam.factors.loop_between import loop_between
from mqslam.factors.psi_between import psi_between

COVARIANCE = np.array([[0.04, 0.01, 0.002], [0.01, 0.01, -0.001], [0.002, -0.001, 0.0009]])
POSE = np.array([3.0, 0.4, 1.1])
PLANAR = psi_between(X(1), X(2), POSE, COVARIANCE)


def error(factor: gtsam.NonlinearFactor, begin: gtsam.Pose3, end: gtsam.Pose3) -> float:
    """Returns the error of a factor, of either kind, between two poses in space."""
    values = gtsam.Values()
    for key, pose in zip(factor.keys(), (begin, end), strict=True):
        is_planar = isinstance(factor, gtsam.BetweenFactorPose2)
        values.insert(key, gtsam.Pose2(pose.x(), pose.y(), pose.rotation().yaw()) if is_planar else pose)
    return float(factor.error(values))


@pytest.mark.parametrize("off", [(1e-3, 0.0, 0.0), (0.0, -2e-3, 0.0), (0.0, 0.0, 1e-3), (2e-3, 1e-3, -1e-3)])
def test_a_planar_error_costs_what_it_costs_in_the_plane(off: tuple[float, float, float]) -> None:
    begin = gtsam.Pose3(gtsam.Pose2(10.0, -4.0, 2.0))
    end = begin.compose(gtsam.Pose3(gtsam.Pose2(*(POSE + off))))
    known = error(PLANAR, begin, end)
    assert known > 0.0
    assert error(lifted_between(PLANAR), begin, end) == pytest.approx(known, rel=1e-3)


def test_height_and_tilt_are_held_weakly() -> None:
    lifted = lifted_between(PLANAR)
    assert list(lifted.keys()) == [X(1), X(2)]
    end = gtsam.Pose3(gtsam.Pose2(*POSE))
    for off, sigma in (((0, 0, 0, 0, 0, 0.04), 0.1), ((0.02, 0, 0, 0, 0, 0), 0.03), ((0, 0.02, 0, 0, 0, 0), 0.03)):
        moved = end.retract(np.array(off))
        assert error(lifted, gtsam.Pose3(), moved) == pytest.approx(0.5 * (max(off) / sigma) ** 2, rel=1e-3)


def test_the_loss_stays_the_same() -> None:
    loop = loop_between(X(1), X(2), Loop(1, 2, POSE, COVARIANCE, 0.8, 0.2))
    far = gtsam.Pose3(gtsam.Pose2(8.0, 0.4, 1.1))
    for planar in (PLANAR, loop):
        assert error(lifted_between(planar), gtsam.Pose3(), far) == pytest.approx(
            error(planar, gtsam.Pose3(), far), rel=1e-6
        )
    gaussian = gtsam.BetweenFactorPose2(X(1), X(2), gtsam.Pose2(*POSE), gtsam.noiseModel.Isotropic.Sigma(3, 0.1))
    assert not isinstance(lifted_between(gaussian).noiseModel(), gtsam.noiseModel.Robust)
