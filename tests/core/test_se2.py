"""Planar motions against the matrices they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from mqslam.core import se2

Matrix = NDArray[np.float64]
SIZES = [0.0, 1e-12, 1e-7, 1e-3, 0.3, 1.0, 3.0]


def matrix(pose: se2.Array) -> Matrix:
    """Returns the homogeneous (3, 3) matrix of a pose."""
    x, y, yaw = pose
    return np.array([[np.cos(yaw), -np.sin(yaw), x], [np.sin(yaw), np.cos(yaw), y], [0.0, 0.0, 1.0]])


def hat(twist: se2.Array) -> Matrix:
    """Returns the (3, 3) matrix of a twist, whose exponential is the matrix of a pose."""
    vx, vy, omega = twist
    return np.array([[0.0, -omega, vx], [omega, 0.0, vy], [0.0, 0.0, 0.0]])


@pytest.fixture
def poses() -> se2.Array:
    """Poses (50, 3) with yaws of several turns."""
    return np.random.default_rng(0).normal(scale=[20.0, 20.0, 4.0], size=(50, 3))


def test_compose_multiplies_matrices(poses: se2.Array) -> None:
    for a, b, ab in zip(poses, poses[::-1], se2.compose(poses, poses[::-1]), strict=True):
        np.testing.assert_allclose(matrix(ab), matrix(a) @ matrix(b), atol=1e-12)


def test_one_pose_is_composed_with_many(poses: se2.Array) -> None:
    expected = [se2.compose(poses[0], pose) for pose in poses]
    np.testing.assert_array_equal(se2.compose(poses[0], poses), expected)


def test_inverse_inverts_the_matrix(poses: se2.Array) -> None:
    for pose, back in zip(poses, se2.inverse(poses), strict=True):
        np.testing.assert_allclose(matrix(back), np.linalg.inv(matrix(pose)), atol=1e-12)


def test_between_is_what_composes_to_the_second_pose(poses: se2.Array) -> None:
    a, b = poses[:-1], poses[1:]
    np.testing.assert_allclose(se2.compose(a, se2.between(a, b)), b, atol=1e-12)


def test_transform_moves_points_as_the_matrix_does(poses: se2.Array) -> None:
    points = np.random.default_rng(1).normal(size=(7, 2))
    for pose in poses[:5]:
        expected = (matrix(pose) @ np.column_stack([points, np.ones(7)]).T).T[:, :2]
        np.testing.assert_allclose(se2.transform(pose, points), expected, atol=1e-12)


@pytest.mark.parametrize("omega", [sign * size for size in SIZES for sign in (1.0, -1.0)])
def test_exp_is_the_matrix_exponential(omega: float) -> None:
    twist = np.array([7.0, -0.4, omega])
    np.testing.assert_allclose(matrix(se2.exp(twist)), expm(hat(twist)), rtol=0.0, atol=1e-13 * 7.0)
    np.testing.assert_allclose(matrix(se2.exp(twist, 0.25)), expm(0.25 * hat(twist)), rtol=0.0, atol=1e-13 * 7.0)


@pytest.mark.parametrize("yaw", [sign * size for size in [*SIZES, 6.0] for sign in (1.0, -1.0)])
def test_log_undoes_exp(yaw: float) -> None:
    twist = np.array([3.0, -1.0, yaw])
    np.testing.assert_allclose(se2.log(se2.exp(twist)), twist, atol=1e-11)


def test_twists_and_durations_are_taken_pairwise() -> None:
    twists, durations = np.array([[1.0, 0.0, 0.2], [2.0, 0.1, -0.3]]), np.array([0.5, 2.0])
    expected = [se2.exp(twist, duration) for twist, duration in zip(twists, durations, strict=True)]
    np.testing.assert_allclose(se2.exp(twists, durations), expected)


def test_adjoint_carries_a_twist_to_the_outer_frame(poses: se2.Array) -> None:
    twist = np.array([0.3, -0.2, 0.1])
    for pose in poses[:10]:
        carried = matrix(pose) @ hat(twist) @ np.linalg.inv(matrix(pose))
        np.testing.assert_allclose(hat(se2.adjoint(pose) @ twist), carried, atol=1e-11)


def test_wrap_brings_angles_between_minus_pi_and_pi() -> None:
    angles = np.array([0.0, 3.0, 3.5, -3.5, 10.0 * np.pi + 0.1, np.pi, -np.pi])
    wrapped = se2.wrap(angles)
    assert np.all((wrapped >= -np.pi) & (wrapped < np.pi))
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * angles), atol=1e-12)
    assert se2.wrap(np.pi) == se2.wrap(-np.pi) == -np.pi


def test_interpolation_follows_the_arc_between_poses_and_goes_on_beyond_them() -> None:
    twist, start = np.array([8.0, 0.3, 0.4]), np.array([5.0, -2.0, 3.0])
    times, at = np.array([0.0, 1.0, 1.5]), np.array([-0.5, 0.0, 0.3, 1.0, 1.2, 1.5, 2.5])
    poses = se2.compose(start, se2.exp(np.tile(twist, (3, 1)), times))
    expected = se2.compose(start, se2.exp(np.tile(twist, (7, 1)), at))
    np.testing.assert_allclose(se2.interpolate(times, poses, at), expected, atol=1e-12)


def test_interpolation_turns_the_short_way_across_the_seam() -> None:
    poses = np.array([[0.0, 0.0, np.pi - 0.1], [0.0, 0.0, -np.pi + 0.1]])
    middle = se2.interpolate(np.array([0.0, 1.0]), poses, np.array([0.5]))[0]
    assert abs(se2.wrap(middle[2] - np.pi)) < 1e-12


def test_a_single_pose_is_held() -> None:
    np.testing.assert_array_equal(se2.interpolate([1.0], [[1.0, 2.0, 3.0]], [0.0, 5.0]), [[1.0, 2.0, 3.0]] * 2)


@pytest.mark.parametrize("apart_s", [1e-6, 1e-4, 1e-2])
@pytest.mark.parametrize("at_s", [0.0, 1.0, 3.75])
def test_two_poses_that_are_stamped_almost_alike_bend_no_curve(apart_s: float, at_s: float) -> None:
    times = np.sort(np.append(np.arange(0.0, 4.0, 0.25), at_s + apart_s))
    poses = np.column_stack([5.0 * times + np.random.default_rng(1).normal(0.0, 0.002, len(times)), np.zeros((17, 2))])
    at = np.linspace(-0.25, 4.0, 500)
    np.testing.assert_allclose(se2.smooth(times, poses, at)[:, 0], 5.0 * at, atol=0.015)
    np.testing.assert_allclose(se2.interpolate(times, poses, at)[:, 0], 5.0 * at, atol=0.015)


def test_a_chain_makes_one_motion_after_the_other() -> None:
    motions = np.tile([2.0, 0.1, 0.3], (30, 1))  # more than a full turn in all
    poses = se2.chain(motions, np.array([5.0, -1.0, 0.2]))
    assert poses.shape == (31, 3)
    np.testing.assert_array_equal(poses[0], [5.0, -1.0, 0.2])
    np.testing.assert_allclose(se2.between(poses[:-1], poses[1:]), motions, atol=1e-12)
    np.testing.assert_array_equal(se2.chain([]), np.zeros((1, 3)))


def test_steps_lead_where_their_chain_does() -> None:
    steps = np.random.default_rng(5).normal(0.0, [1.0, 0.2, 0.4], (200, 3))
    np.testing.assert_allclose(se2.integrate_steps(steps), se2.chain(steps), atol=1e-9)


def test_a_wrapped_relative_pose_turns_the_short_way() -> None:
    a, b = np.array([[1.0, 2.0, 3.0], [0.0, 0.0, -3.0]]), np.array([[2.0, 2.0, -3.0], [1.0, 0.0, 9.5]])
    relative = se2.wrapped_between(a, b)
    np.testing.assert_allclose(relative[:, :2], se2.between(a, b)[:, :2])
    np.testing.assert_allclose(relative[:, 2], [2.0 * np.pi - 6.0, 12.5 - 4.0 * np.pi])
    np.testing.assert_array_equal(se2.wrapped_between(a[0], b[0]), relative[0])


def test_the_path_is_as_long_as_its_steps() -> None:
    poses = np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 1.0], [3.0, 4.0, 2.0], [3.0, 16.0, 0.0]])
    np.testing.assert_array_equal(se2.step_lengths(poses), [5.0, 0.0, 12.0])
    np.testing.assert_array_equal(se2.path_lengths(poses), [0.0, 5.0, 5.0, 17.0])


def test_an_angle_in_range_keeps_its_last_bit() -> None:
    angles = np.array([1e-17, -0.3, 0.1, 3.0, -np.pi])
    np.testing.assert_array_equal(se2.wrap(angles), angles)
    np.testing.assert_allclose(se2.wrap(angles + 2.0 * np.pi), angles, rtol=0.0, atol=1e-15)


def test_returns_of_scans_that_arrive_in_a_burst_are_seen_from_the_poses_of_these_scans() -> None:
    times = np.array([0.0, 1.0, 2.0, 2.001, 2.002, 3.0, 4.0])
    poses = np.column_stack([np.arange(7.0), np.zeros(7), 0.3 * np.arange(7.0)])
    at = np.repeat(times[2:6], 5)
    np.testing.assert_array_equal(se2.find_poses_of_returns(times, poses, at), np.repeat(poses[2:6], 5, axis=0))


def test_returns_between_poses_are_seen_from_the_smooth_curve() -> None:
    times = np.arange(5.0)
    poses = np.column_stack([times**2, np.zeros(5), 0.1 * times])
    at = np.array([1.0, 1.5, 2.25])
    np.testing.assert_array_equal(se2.find_poses_of_returns(times, poses, at), se2.smooth(times, poses, at))


def test_the_difference_of_many_poses_wraps_each_yaw_and_nothing_else(poses: se2.Array) -> None:
    for count in (2, 50):
        expected = [[a[0] - b[0], a[1] - b[1], se2.wrap(a[2] - b[2])] for a, b in zip(poses, poses[::-1], strict=True)]
        np.testing.assert_array_equal(se2.subtract(poses[:count], poses[::-1][:count]), expected[:count])
