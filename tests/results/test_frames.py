"""A run's poses carried to the vehicle are those of a radar that sits elsewhere on it."""

from __future__ import annotations

import numpy as np

from mqslam.backend.linear.marginals import PoseCovariances
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.results.frames import carry_covariances_to_vehicle, carry_to_vehicle

MOUNT = np.array([1.8, -0.3, 0.4])


def test_the_radar_sits_where_the_mount_says_on_every_pose_of_the_vehicle() -> None:
    radar = Trajectory(np.arange(3) * 250_000, np.array([[0.0, 0.0, 0.0], [2.0, 0.1, 0.1], [4.0, 0.5, 0.3]]))
    vehicle = carry_to_vehicle(radar, MOUNT)
    np.testing.assert_allclose(se2.compose(vehicle.poses, MOUNT), radar.poses, atol=1e-12)
    np.testing.assert_array_equal(vehicle.stamps_us, radar.stamps_us)


def test_the_covariance_of_a_carried_pose_is_that_of_poses_drawn_from_it() -> None:
    covariance = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.003], [0.002, -0.003, 0.001]])
    carried = carry_covariances_to_vehicle(PoseCovariances(np.array([0]), covariance[None]), MOUNT).covariances[0]
    rng, pose = np.random.default_rng(1), np.array([5.0, -2.0, 0.7])
    drawn = 1e-2 * rng.multivariate_normal(np.zeros(3), covariance, 20_000)  # small, as a linear law holds for
    vehicle = se2.compose(pose, se2.inverse(MOUNT))
    off = se2.between(vehicle, se2.compose(se2.compose(pose, drawn), se2.inverse(MOUNT)))
    np.testing.assert_allclose(1e4 * np.cov(off.T), carried, atol=0.03 * np.abs(carried).max())
