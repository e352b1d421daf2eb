from __future__ import annotations

import numpy as np
import pytest
from support.motion_models import MODELS

from mqslam.core import se2
from mqslam.core.motion import MotionModel
from mqslam.core.scans import Returns
from mqslam.psi.place import Beam, PointSet, place

T0 = 3.0
START = np.array([40.0, -7.0, 0.8])
THETAS = {
    "constant_velocity": np.array([12.0, 0.5]),
    "constant_twist": np.array([12.0, -0.7, 0.5]),
    "accelerated_twist": np.array([12.0, -0.7, 0.5, 3.0, -0.4]),
}
models = pytest.mark.parametrize("model", MODELS.values(), ids=list(MODELS))
betas = pytest.mark.parametrize("beta", [0.0, 0.05, -0.05])


def some_returns(count: int = 30) -> Returns:
    rng = np.random.default_rng(2)
    return Returns(
        rng.uniform(3.0, 100.0, count),
        rng.uniform(-np.pi, np.pi, count),
        np.sort(rng.uniform(T0, T0 + 0.75, count)),
        rng.uniform(50.0, 200.0, count),
    )


def placed(start: se2.Array, theta: se2.Array, model: MotionModel, beta: float) -> PointSet:
    return place(some_returns(), T0, start, theta, model, Beam(0.15, 0.008, beta))


def step_by_step(start: se2.Array, theta: se2.Array, model: MotionModel, beta: float) -> np.ndarray:
    """Renders each return on its own: the pose at its time, the closing speed along its ray, the point."""
    returns, points = some_returns(), []
    for r, azimuth, t in zip(returns.ranges, returns.azimuths, returns.times - T0, strict=True):
        ray = np.array([np.cos(azimuth), np.sin(azimuth)])
        twist = np.zeros(3)
        for component, power, value in zip(model.components, model.powers, theta, strict=True):
            twist[component] += value * t**power
        pose = se2.compose(start, model.pose(theta, t)[0])
        points.append(se2.transform(pose, [(r + beta * ray @ twist[:2]) * ray])[0])
    return np.array(points)


@models
@betas
def test_a_return_lies_where_the_sensor_was_at_its_own_time(model: MotionModel, beta: float) -> None:
    theta = THETAS[model.name]
    result = placed(START, theta, model, beta)
    np.testing.assert_allclose(result.points, step_by_step(START, theta, model, beta), atol=1e-10)
    np.testing.assert_array_equal(result.times, some_returns().times)


@models
@betas
def test_jacobians_are_those_of_finite_differences(model: MotionModel, beta: float) -> None:
    state, step = np.r_[START, THETAS[model.name]], 1e-6
    jacobians = placed(state[:3], state[3:], model, beta).jacobians
    assert jacobians.shape == (30, 2, 3 + model.size)
    for p in range(len(state)):
        ahead, behind = (state + sign * step * np.eye(len(state))[p] for sign in (1.0, -1.0))
        up, down = (placed(s[:3], s[3:], model, beta).points for s in (ahead, behind))
        np.testing.assert_allclose(jacobians[:, :, p], (up - down) / (2.0 * step), atol=1e-6)


@models
@betas
def test_rays_point_from_where_the_sensor_was_to_the_return(model: MotionModel, beta: float) -> None:
    theta, returns = THETAS[model.name], some_returns()
    result = placed(START, theta, model, beta)
    sensor = np.array([se2.compose(START, model.pose(theta, t)[0])[:2] for t in returns.times - T0])
    away = result.points - sensor
    np.testing.assert_allclose(np.hypot(*result.rays.T), 1.0, rtol=1e-12)
    np.testing.assert_allclose(result.rays, away / np.hypot(*away.T)[:, None], atol=1e-10)


def test_doppler_lengthens_what_the_sensor_drives_at() -> None:
    returns = Returns(np.full(3, 20.0), np.array([0.0, np.pi / 2.0, np.pi]), np.full(3, T0), np.full(3, 100.0))
    result = place(returns, T0, np.zeros(3), np.array([10.0, 0.0]), MODELS["constant_velocity"], Beam(0.1, 0.01, 0.05))
    np.testing.assert_allclose(result.points, [[20.5, 0.0], [0.0, 20.0], [-19.5, 0.0]], atol=1e-12)


def test_covariances_are_long_along_the_ray_and_wide_across_it() -> None:
    theta = THETAS["constant_twist"]
    result, returns = placed(START, theta, MODELS["constant_twist"], 0.0), some_returns()
    for i, t in enumerate(returns.times - T0):
        yaw = START[2] + theta[2] * t + returns.azimuths[i]
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        polar = np.diag([0.15**2, (0.008 * returns.ranges[i]) ** 2])
        np.testing.assert_allclose(result.covariances[i], (turn @ polar @ turn.T)[[0, 0, 1], [0, 1, 1]], atol=1e-12)


def test_no_returns_are_no_points() -> None:
    none = Returns(*(np.empty(0) for _ in range(4)))
    result = place(none, T0, START, THETAS["constant_twist"], MODELS["constant_twist"], Beam(0.1, 0.01))
    assert len(result) == 0
    assert result.jacobians.shape == (0, 2, 6)
    assert result.rays.shape == (0, 2)
