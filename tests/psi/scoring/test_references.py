"""Sums over listed pairs are the sums over neighbours that are looked up anew."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig
from mqslam.psi.minimiser import SKIN_M, annealed_scale, final_scale, kernel_of
from mqslam.psi.neighbours import NearbyLists, do_serve, list_near
from mqslam.psi.place import PointSet
from mqslam.psi.score import Neighbours, References, Scale, add_up_neighbours, find_reach, make_references

CONFIG = EstimatorConfig()
KERNEL = kernel_of(CONFIG, 0.0)


def scattered(seed: int, count: int, half_m: float = 20.0) -> PointSet:
    rng = np.random.default_rng(seed)
    covariances = np.column_stack(
        [rng.uniform(0.1, 0.2, count), rng.uniform(-0.05, 0.05, count), rng.uniform(0.1, 0.2, count)]
    )
    return PointSet(rng.uniform(-half_m, half_m, (count, 2)), np.empty((count, 2, 0)), covariances, np.arange(float(count)))


def add_up(points: NDArray[np.float64], lists: NearbyLists, references: References, scale: Scale) -> NDArray[np.float64]:
    sums, no_pulls = np.full((len(points), 10), np.nan), np.empty((0, 2, 0))
    near = Neighbours(references.known, no_pulls, lists.offsets, lists.indices)
    add_up_neighbours(points, np.empty(0), np.empty((0, 2)), near, scale, KERNEL, sums, no_pulls)
    return sums


def add_up_anew(points: NDArray[np.float64], references: References, scale: Scale) -> NDArray[np.float64]:
    lists = list_near(references.grid, points, find_reach(scale, KERNEL))
    return add_up(points, lists, references, scale)


def list_all(points: NDArray[np.float64], references: References, reach: float) -> NearbyLists:
    return list_near(references.grid, points, reach + SKIN_M)


@pytest.mark.parametrize("half_m", [3.0, 20.0, 400.0])
def test_sums_of_a_search_are_those_of_neighbours_looked_up_anew(half_m: float) -> None:
    rng, references = np.random.default_rng(1), make_references(scattered(2, 3000, half_m))
    points, lists = references.points[:1500] + 0.1, 0
    listed = list_all(points, references, 0.0)
    for step in range(12):
        points = points + rng.normal(0.0, 0.3 * 0.6**step, 2)
        scale = annealed_scale(CONFIG, step)
        if not do_serve(listed, points, find_reach(scale, KERNEL), SKIN_M):
            listed, lists = list_all(points, references, find_reach(scale, KERNEL)), lists + 1
        expected = add_up_anew(points, references, scale)
        np.testing.assert_allclose(add_up(points, listed, references, scale), expected, rtol=1e-12, atol=0.0)
    assert 2 <= lists <= 6


def test_a_list_serves_small_moves_and_no_large_ones() -> None:
    references, reach = make_references(scattered(3, 500)), 0.5
    points = scattered(4, 300).points
    listed = list_all(points, references, reach)
    assert do_serve(listed, points + np.array([0.1, 0.0]), reach, SKIN_M)
    assert not do_serve(listed, points + np.array([0.3, 0.0]), reach, SKIN_M)
    assert not do_serve(listed, points, 1.0, SKIN_M)
    assert not do_serve(list_all(points, references, 4.0 * reach), points, reach, SKIN_M)


@pytest.mark.parametrize("count", [0, 1])
def test_points_without_any_reference_have_no_sums(count: int) -> None:
    points, references = scattered(5, 7).points + 50.0, make_references(scattered(6, count, 0.1))
    listed = list_all(points, references, 1.0)
    np.testing.assert_array_equal(add_up(points, listed, references, final_scale(CONFIG)), np.zeros((7, 10)))


def test_no_points_have_no_sums() -> None:
    points, references = np.empty((0, 2)), make_references(scattered(7, 20))
    listed = list_all(points, references, 1.0)
    assert add_up(points, listed, references, final_scale(CONFIG)).shape == (0, 10)
