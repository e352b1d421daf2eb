from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from support.motion_models import MODELS

from mqslam.core import se2
from mqslam.core.motion import ACCELERATED_TWIST, CONSTANT_TWIST, CONSTANT_VELOCITY, MotionModel, integrate

THETAS = {
    "constant_velocity": np.array([12.0, 0.5]),
    "constant_twist": np.array([12.0, -0.7, 0.5]),
    "accelerated_twist": np.array([12.0, -0.7, 0.5, 3.0, -0.4]),
}
TIMES = np.array([-0.1, 0.0, 0.05, 0.25, 0.75, 1.0])
models = pytest.mark.parametrize("model", MODELS.values(), ids=list(MODELS))


def twist_at(model: MotionModel, theta: se2.Array, t: float) -> se2.Array:
    twist = np.zeros(3)
    for component, power, value in zip(model.components, model.powers, theta, strict=True):
        twist[component] += value * t**power
    return twist


def by_ode(model: MotionModel, theta: se2.Array, t: float) -> se2.Array:
    """Integrates the body twist to a pose, in steps that a solver controls."""

    def rate(u: float, pose: se2.Array) -> se2.Array:
        vx, vy, omega = twist_at(model, theta, u)
        c, s = np.cos(pose[2]), np.sin(pose[2])
        return np.array([c * vx - s * vy, s * vx + c * vy, omega])

    return np.asarray(solve_ivp(rate, (0.0, t), np.zeros(3), rtol=1e-12, atol=1e-12).y[:, -1])


def random_poses(yaw: float) -> st.SearchStrategy[se2.Array]:
    reach = st.floats(-50.0, 50.0)
    return st.tuples(reach, reach, st.floats(-yaw, yaw)).map(np.array)


@models
def test_poses_and_twists_are_those_of_an_ode_solver(model: MotionModel) -> None:
    theta = THETAS[model.name]
    poses, _, twists = integrate(theta, *model.arrays, TIMES)
    for t, pose, twist in zip(TIMES, poses, twists, strict=True):
        np.testing.assert_allclose(pose, by_ode(model, theta, t), atol=1e-9)
        np.testing.assert_allclose(twist, twist_at(model, theta, t), atol=1e-12)


@models
def test_jacobians_are_those_of_finite_differences(model: MotionModel) -> None:
    theta, step = THETAS[model.name], 1e-6
    jacobians = integrate(theta, *model.arrays, TIMES)[1]
    for p in range(model.size):
        up, down = (integrate(theta + sign * step * np.eye(model.size)[p], *model.arrays, TIMES)[0] for sign in (1, -1))
        np.testing.assert_allclose(jacobians[:, :, p], (up - down) / (2.0 * step), atol=1e-7)


@models
def test_a_pose_is_one_row_of_the_integral(model: MotionModel) -> None:
    theta = THETAS[model.name]
    pose, jacobian = model.pose(theta, 0.75)
    poses, jacobians, _ = integrate(theta, *model.arrays, np.array([0.75]))
    np.testing.assert_array_equal(pose, poses[0])
    np.testing.assert_array_equal(jacobian, jacobians[0])


@pytest.mark.parametrize("omega", [0.0, 1e-9, 0.3, -1.2])
def test_a_constant_twist_is_the_exponential(omega: float) -> None:
    twist = np.array([20.0, -1.0, omega])
    for t in TIMES:
        np.testing.assert_allclose(CONSTANT_TWIST.pose(twist, t)[0], se2.exp(twist, t), atol=1e-9)


def test_models_agree_where_one_holds_the_other() -> None:
    slow = CONSTANT_VELOCITY.pose(np.array([8.0, 0.2]), 0.5)[0]
    np.testing.assert_allclose(CONSTANT_TWIST.pose(np.array([8.0, 0.0, 0.2]), 0.5)[0], slow, atol=1e-15)
    np.testing.assert_allclose(ACCELERATED_TWIST.pose(np.array([8.0, 0.0, 0.2, 0.0, 0.0]), 0.5)[0], slow, atol=1e-15)


def test_an_acceleration_ahead_adds_half_its_square_in_time() -> None:
    pose, _ = ACCELERATED_TWIST.pose(np.array([8.0, 0.0, 0.0, 3.0, 0.0]), 0.5)
    np.testing.assert_allclose(pose, [8.0 * 0.5 + 0.5 * 3.0 * 0.25, 0.0, 0.0], atol=1e-14)


def test_a_twist_enters_a_model_as_far_as_the_model_can_hold_it() -> None:
    twist = np.array([8.0, -0.5, 0.2])
    np.testing.assert_array_equal(CONSTANT_VELOCITY.from_twist(twist), [8.0, 0.2])
    np.testing.assert_array_equal(CONSTANT_TWIST.from_twist(twist), twist)
    np.testing.assert_array_equal(ACCELERATED_TWIST.from_twist(twist), [8.0, -0.5, 0.2, 0.0, 0.0])


@given(twist=random_poses(6.0))
def test_log_undoes_exp(twist: se2.Array) -> None:
    np.testing.assert_allclose(se2.log(se2.exp(twist)), twist, atol=1e-6)


@given(pose=random_poses(6.0), t=st.floats(0.0, 1.0))
def test_exp_undoes_log_and_its_halves_compose(pose: se2.Array, t: float) -> None:
    twist = se2.log(pose)
    np.testing.assert_allclose(se2.exp(twist), pose, atol=1e-9)
    np.testing.assert_allclose(se2.compose(se2.exp(twist, t), se2.exp(twist, 1.0 - t)), pose, atol=1e-6)
