from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.frontends.icp_covariance import Surface

POSE = np.array([3.0, -1.0, 0.5 * np.pi])  # heads along y of the map


def surface(points: NDArray[np.float64]) -> Surface:
    return Surface(points, 1.0)


def scene(rng: np.random.Generator, thick: float) -> NDArray[np.float64]:
    """Returns two walls along x of the map, 20 m apart."""
    along = rng.uniform(-40.0, 40.0, 800)
    return np.column_stack([along, np.where(rng.random(800) < 0.5, -10.0, 10.0) + rng.normal(0.0, thick, 800)])


def covariance(thick: float, noise: float = 0.1) -> NDArray[np.float64]:
    rng = np.random.default_rng(1)
    points = scene(rng, thick)
    scan = se2.transform(se2.inverse(POSE), points + rng.normal(0.0, noise, points.shape))
    return surface(points).compute_covariance(scan, POSE, 2.0, 1.0)


def test_it_is_large_along_walls_in_the_frame_of_the_pose() -> None:
    spread = covariance(0.05)
    np.testing.assert_array_equal(spread, spread.T)
    np.testing.assert_array_less(0.0, np.linalg.eigvalsh(spread))
    assert spread[1, 1] > 20.0 * spread[0, 0]  # the walls run to the left of the pose


def test_it_grows_with_the_residuals() -> None:
    assert np.trace(covariance(0.05, noise=0.2)) > 2.0 * np.trace(covariance(0.05, noise=0.1))


def test_points_spread_all_ways_count_as_point_to_point_residuals_do() -> None:
    rng = np.random.default_rng(2)
    lattice = np.stack(np.meshgrid(np.arange(-20.0, 20.0), np.arange(-20.0, 20.0)), axis=-1).reshape(-1, 2)
    off = rng.normal(0.0, 0.05, lattice.shape)
    scan = se2.transform(se2.inverse(POSE), lattice + off)
    spread = surface(lattice).compute_covariance(scan, POSE, 0.5, 1e6)  # so wide a kernel weighs all alike
    variance = np.mean(off**2)
    assert spread[0, 0] == pytest.approx(variance / len(scan), rel=0.4)
    centred = scan - scan.mean(axis=0)
    assert spread[2, 2] == pytest.approx(variance / (centred**2).sum(), rel=0.4)


def test_matched_counts_the_points_within_reach() -> None:
    line = surface(np.array([[0.0, 0.0], [5.0, 0.0]]))
    assert line.count_matched(np.array([[0.5, 0.0], [4.0, 0.0], [2.5, 0.0]]), np.zeros(3), 0.9) == 1
    assert line.count_matched(np.empty((0, 2)), np.zeros(3), 0.9) == 0


def test_a_scan_that_lies_exactly_on_the_map_is_not_known_without_error() -> None:
    assert np.linalg.eigvalsh(covariance(0.05, noise=0.0))[0] > 0.0


def test_returns_at_the_sensor_leave_the_yaw_open() -> None:
    spread = surface(np.zeros((30, 2))).compute_covariance(np.zeros((30, 2)), np.zeros(3), 2.0, 1.0)
    np.testing.assert_array_less(0.0, np.linalg.eigvalsh(spread))
    assert spread[2, 2] > 100.0 * spread[0, 0]
