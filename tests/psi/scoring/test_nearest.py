"""The nearest points of a grid are those of a tree."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from mqslam.frontends.icp_covariance import find_nearest
from mqslam.psi.neighbours import sort_into_cells


@given(
    seed=st.integers(0, 2**32 - 1),
    counts=st.tuples(st.integers(1, 80), st.integers(0, 30)),
    side=st.sampled_from([0.5, 10.0, 1000.0]),
    cell=st.floats(0.1, 20.0),
    nearest=st.integers(1, 12),
    away=st.sampled_from([0.0, 30.0, -1e4, 1e12]),
)
@settings(max_examples=200, deadline=None)
def test_the_nearest_points_are_those_of_a_tree(
    seed: int, counts: tuple[int, int], side: float, cell: float, nearest: int, away: float
) -> None:
    rng = np.random.default_rng(seed)
    points, queries = (rng.uniform(-0.5 * side, 0.5 * side, (count, 2)) for count in counts)
    queries = 1.5 * queries + [away, 0.0]
    nearest = min(nearest, len(points))
    distances, indices = find_nearest(sort_into_cells(points, cell), queries, nearest)
    expected, _ = cKDTree(points).query(queries, k=list(range(1, nearest + 1)))
    np.testing.assert_allclose(distances, expected, rtol=1e-12)
    assert all(len(set(row)) == nearest for row in indices.tolist())
    np.testing.assert_allclose(np.linalg.norm(points[indices] - queries[:, None], axis=2), distances, rtol=1e-12)


@pytest.mark.parametrize("count", [1, 3])
def test_points_in_one_place_are_all_among_the_nearest(count: int) -> None:
    distances, indices = find_nearest(sort_into_cells(np.zeros((3, 2)), 1.0), np.ones((1, 2)), count)
    np.testing.assert_allclose(distances, np.sqrt(2.0))
    assert len(set(indices[0].tolist())) == count
