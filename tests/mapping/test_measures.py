"""The field's measures, against definitions written out point by point."""

from __future__ import annotations

import numpy as np
import pytest

from mqslam.config import AuditConfig
from mqslam.mapping.measures import (
    accumulate_evidence,
    compute_grid_entropy,
    compute_measures,
    locate_sensors,
)

RNG = np.random.default_rng(3)
POINTS = RNG.uniform(-4.0, 4.0, (300, 2)) * [1.0, 0.2]
SWEEPS = np.repeat(np.arange(3), 100)
SENSORS = np.zeros((300, 2))


def neighbourhoods(points: np.ndarray, radius: float) -> list[np.ndarray]:
    return [points[np.hypot(*(points - p).T) <= radius] for p in points]


def entropy(points: np.ndarray) -> float:
    covariance = np.cov(points.T, bias=True) + 1e-6 * np.eye(2)
    return 0.5 * np.log(np.linalg.det(2.0 * np.pi * np.e * covariance))


def test_mean_map_entropy_and_plane_variance_are_those_of_numpy() -> None:
    result = compute_measures(POINTS, SWEEPS, SENSORS, AuditConfig(radius_m=1.0))
    filled = [n for n in neighbourhoods(POINTS, 1.0) if len(n) >= 5]
    assert result.map_entropy == pytest.approx(np.mean([entropy(n) for n in filled]), abs=1e-9)
    least = [np.linalg.eigvalsh(np.cov(n.T, bias=True) + 1e-6 * np.eye(2))[0] for n in filled]
    assert result.plane_variance == pytest.approx(np.mean(least), abs=1e-9)


def test_joint_entropy_is_that_of_all_sweeps_less_that_of_each_points_own() -> None:
    result = compute_measures(POINTS, SWEEPS, SENSORS, AuditConfig(radius_m=1.5))
    differences = []
    for point, sweep in zip(POINTS, SWEEPS, strict=True):
        near = np.hypot(*(POINTS - point).T) <= 1.5
        own = near & (sweep == SWEEPS)
        if near.sum() >= 5 and own.sum() >= 5:
            differences.append(entropy(POINTS[near]) - entropy(POINTS[own]))
    assert result.joint_entropy == pytest.approx(np.mean(differences), abs=1e-9)


def test_a_doubled_wall_is_worse_by_every_entropy_than_a_single_one() -> None:
    x = np.tile(np.linspace(-5.0, 5.0, 200), 2)
    y = 5.0 + 0.01 * RNG.normal(size=400)
    twice = np.c_[x, y + np.repeat([0.0, 0.4], 200)]
    sweeps, sensors = np.repeat([0, 1], 200), np.zeros((400, 2))
    good, bad = (compute_measures(p, sweeps, sensors, AuditConfig(radius_m=0.5)) for p in (np.c_[x, y], twice))
    assert bad.map_entropy > good.map_entropy + 1.0
    assert bad.plane_variance > 10.0 * good.plane_variance
    assert bad.joint_entropy > good.joint_entropy + 1.0
    assert bad.grid_entropy > good.grid_entropy


def test_evidence_of_one_beam_is_free_on_the_way_and_occupied_at_its_end() -> None:
    odds, seen = accumulate_evidence(np.array([[0.5, 0.5]]), np.array([[5.5, 0.5]]), (7, 2))
    assert seen[:, 0].tolist() == [True] * 6 + [False] and not seen[:, 1].any()
    assert np.all(odds[:5, 0] < 0.0) and odds[5, 0] > 0.0


def test_evidence_is_that_of_a_walk_in_numpy() -> None:
    begins, ends = RNG.uniform(0.0, 20.0, (50, 2)), RNG.uniform(0.0, 20.0, (50, 2))
    expected, visited = np.zeros((21, 21)), np.zeros((21, 21), dtype=bool)
    for a, b in zip(begins, ends, strict=True):
        steps = int(np.ceil(np.abs(b - a).max()))
        for x, y in np.floor(a + np.arange(steps)[:, None] / max(steps, 1) * (b - a)).astype(int):
            visited[x, y] = True
            expected[x, y] = max(expected[x, y] - 0.4, -3.5)
        x, y = np.floor(b).astype(int)
        visited[x, y] = True
        expected[x, y] = min(expected[x, y] + 0.85, 3.5)
    odds, seen = accumulate_evidence(begins, ends, (21, 21))
    np.testing.assert_array_equal(seen, visited)
    np.testing.assert_allclose(odds, expected, atol=1e-12)


def test_nothing_has_no_measure() -> None:
    empty = np.empty((0, 2))
    result = compute_measures(empty, np.empty(0, dtype=np.int64), empty, AuditConfig())
    assert np.isnan([result.map_entropy, result.plane_variance, result.joint_entropy, result.grid_entropy]).all()
    assert np.isnan(compute_grid_entropy(empty, empty, 0.5))


def test_the_sensor_is_between_its_poses() -> None:
    poses = np.array([[0.0, 0.0, 0.0], [2.0, 4.0, 1.0]])
    np.testing.assert_allclose(locate_sensors(np.array([3.0, 3.5]), np.array([3.0, 4.0]), poses), [[0.0, 0.0], [1.0, 2.0]])
