"""The factor of a gyroscope's turn is what its formula says, wherever it is evaluated."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import C, X

from mqslam.factors.gyroscope_turn import GyroscopeTurn, bias_walk, gyroscope_turn

TURN = GyroscopeTurn(angle=0.3, duration_s=0.25, sigma=0.01)


def values(a: float, b: float, bias: float, scale_error: float) -> gtsam.Values:
    result = gtsam.Values()
    result.insert(X(0), gtsam.Pose2(3.0, -1.0, a))
    result.insert(X(1), gtsam.Pose2(5.0, 2.0, b))
    result.insert(C(0), np.array([bias, scale_error]))
    return result


@pytest.mark.parametrize("yaws", [(0.0, 0.3), (3.0, -2.9), (-3.1, 3.0)])
@pytest.mark.parametrize(("bias", "scale_error"), [(0.0, 0.0), (0.05, -0.02)])
def test_the_error_is_that_of_the_formula(yaws: tuple[float, float], bias: float, scale_error: float) -> None:
    factor = gyroscope_turn(X(0), X(1), C(0), TURN, yaws)
    for a, b in ((0.0, 0.0), (0.1, -0.2), (-1.0, 0.5)):
        at = values(yaws[0] + a, yaws[1] + b, bias, scale_error)
        turned = (yaws[1] - yaws[0] + np.pi) % (2.0 * np.pi) - np.pi + b - a
        error = turned - (1.0 + scale_error) * TURN.angle + bias * TURN.duration_s
        assert factor.error(at) == pytest.approx(0.5 * (error / TURN.sigma) ** 2, abs=1e-9)


def test_a_graph_of_turns_finds_bias_and_scale() -> None:
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    angles, bias, scale_error = [0.3, -0.2, 0.0, 0.5], 0.04, 0.02
    yaws = np.cumsum([0.0, *((1.0 + scale_error) * np.array(angles) - bias * 0.25)])
    exact = gtsam.noiseModel.Isotropic.Sigma(3, 1e-4)
    for k, yaw in enumerate(yaws):
        start.insert(X(k), gtsam.Pose2(0.0, 0.0, yaw + 0.1))
        graph.push_back(gtsam.PriorFactorPose2(X(k), gtsam.Pose2(0.0, 0.0, yaw), exact))
    for k, angle in enumerate(angles):
        turn = GyroscopeTurn(angle, 0.25, 1e-4)
        graph.push_back(gyroscope_turn(X(k), X(k + 1), C(k // 2), turn, (yaws[k] + 0.2, yaws[k + 1] + 0.2)))
    graph.push_back(bias_walk(C(0), C(1), 1e-6, 1e-6))
    for j in range(2):
        start.insert(C(j), np.zeros(2))
    graph.push_back(gtsam.PriorFactorVector(C(0), np.zeros(2), gtsam.noiseModel.Isotropic.Sigma(2, 10.0)))
    optimum = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()
    for j in range(2):
        np.testing.assert_allclose(optimum.atVector(C(j)), [bias, scale_error], atol=2e-3)
