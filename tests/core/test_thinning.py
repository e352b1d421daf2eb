"""A map thinned to as many points as a page holds."""

from __future__ import annotations

import numpy as np
import pytest

from mqslam.core.point_map import find_first_of_cells, pick_thinned


@pytest.mark.parametrize("cell", [0.003, 0.1, 2.0, 50.0])
def test_the_first_point_of_every_cell_is_found(cell: float) -> None:
    points = np.random.default_rng(1).exponential(5.0, (3000, 2))
    cells, first = np.unique(np.floor(points / cell).astype(np.int64), axis=0, return_index=True)
    np.testing.assert_array_equal(find_first_of_cells(points, cell, len(points)), np.sort(first))
    assert len(find_first_of_cells(points, cell, len(cells) - 1)) == len(cells)


def test_as_many_points_stay_as_may_and_they_are_spread_evenly() -> None:
    dense, sparse = np.random.default_rng(2).random((2, 20_000, 2))
    points = np.concatenate([dense, 40.0 * sparse + 5.0])
    picked = pick_thinned(points, 1000)
    assert 900 < len(picked) <= 1000 and len(np.unique(picked)) == len(picked)
    assert np.sum(picked < 20_000) < 10, "one square metre of a thousand takes few of the points"
    np.testing.assert_array_equal(pick_thinned(points[:500], 1000), np.arange(500))
