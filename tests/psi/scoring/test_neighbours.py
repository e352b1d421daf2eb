from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.psi.minimiser import renew_lists
from mqslam.psi.neighbours import NearbyLists, find_candidates, mark_near, sort_into_cells
from mqslam.psi.place import PointSet
from mqslam.psi.score import References, make_references

Points = NDArray[np.float64]


def sets(lists: NearbyLists) -> list[list[int]]:
    spans = zip(lists.offsets[:-1], lists.offsets[1:], strict=True)
    return [sorted(lists.indices[a:b].tolist()) for a, b in spans]


def by_tree(references: Points, queries: Points, radius: float) -> list[list[int]]:
    return [sorted(result) for result in cKDTree(references).query_ball_point(queries, radius)]


def square(seed: int, count: int, side: float = 10.0) -> Points:
    return np.random.default_rng(seed).uniform(-side / 2.0, side / 2.0, (count, 2))


def holds_all_within(lists: NearbyLists, references: Points, queries: Points, radius: float) -> bool:
    wanted = by_tree(references, queries, radius)
    return all(set(want) <= set(result) for want, result in zip(wanted, sets(lists), strict=True))


@given(
    seed=st.integers(0, 2**32 - 2),
    counts=st.tuples(st.integers(0, 60), st.integers(0, 60)),
    side=st.sampled_from([0.5, 10.0, 1000.0, 1e5]),  # in the widest one the first points of cells are not listed
    cell=st.floats(0.05, 20.0),
    radius=st.floats(0.05, 8.0),
    x=st.floats(-1e4, 1e4),
)
@settings(max_examples=200, deadline=None)
def test_candidates_are_those_of_a_tree(
    seed: int, counts: tuple[int, int], side: float, cell: float, radius: float, x: float
) -> None:
    away = np.array([x, 0.0])
    references, queries = square(seed, counts[0], side) + away, square(seed + 1, counts[1], 1.2 * side) + away
    lists = find_candidates(sort_into_cells(references, cell), queries, radius)
    assert lists.radius == radius
    assert sets(lists) == by_tree(references, queries, radius)


@pytest.mark.parametrize("count", [0, 1, 60])
def test_queries_with_a_candidate_are_marked(count: int) -> None:
    references, queries = square(1, count), square(2, 50, side=20.0)
    for radius in (0.3, 1.0, 4.0):
        expected = [len(near) > 0 for near in by_tree(references, queries, radius)]
        assert mark_near(sort_into_cells(references, 1.0), queries, radius).tolist() == expected


def test_points_in_one_place_are_all_listed_and_a_query_finds_itself() -> None:
    references = np.repeat(square(1, 5), 4, axis=0)
    lists = find_candidates(sort_into_cells(references, 1.0), references, 1e-6)
    assert sets(lists) == [list(range(4 * (k // 4), 4 * (k // 4) + 4)) for k in range(20)]


def test_an_empty_grid_has_no_candidates() -> None:
    lists = find_candidates(sort_into_cells(np.empty((0, 2)), 1.0), square(1, 7), 3.0)
    assert sets(lists) == [[]] * 7


@pytest.mark.parametrize("off", [(-1e6, 0.0), (1e6, 0.0), (0.0, -1e6), (0.0, 1e6), (11.0, 0.0), (0.0, -11.0)])
def test_queries_outside_the_grid_find_nothing(off: tuple[float, float]) -> None:
    queries = square(2, 10) + off
    assert sets(find_candidates(sort_into_cells(square(1, 50), 1.0), queries, 0.9)) == [[]] * 10


class Renewed:
    """Lists of the neighbours of points, and how often they were made."""

    def __init__(self) -> None:
        self.lists: NearbyLists | None = None
        self.builds = 0

    def reach(self, points: Points, references: References | None, reach: float) -> NearbyLists:
        lists = renew_lists(self.lists, points, references, reach)
        self.builds += lists is not self.lists
        self.lists = lists
        return lists


def fixed(points: Points) -> References:
    count = len(points)
    return make_references(PointSet(points, np.zeros((0, 2, 0)), np.ones((count, 3)), np.zeros(count)))


@pytest.mark.parametrize("with_map", [True, False])
def test_lists_hold_every_neighbour_while_points_move(with_map: bool) -> None:
    renewed, rng = Renewed(), np.random.default_rng(6)
    queries = square(1, 60)
    references = fixed(square(2, 60)) if with_map else None
    calls = 40
    for _ in range(calls):
        queries = queries + rng.uniform(-0.04, 0.04, queries.shape)
        lists = renewed.reach(queries, references, 1.0)
        assert holds_all_within(lists, queries if references is None else references.grid.points, queries, 1.0)
    assert 1 < renewed.builds < calls / 2


def test_lists_are_kept_until_points_have_moved_by_the_skin() -> None:
    start, references = square(1, 20), fixed(square(2, 20))

    def builds(moves: tuple[float, ...], references: References | None) -> list[int]:
        renewed, counts = Renewed(), []
        for moved in moves:
            renewed.reach(start + np.array([moved, 0.0]), references, 1.0)
            counts.append(renewed.builds)
        return counts

    assert builds((0.0, 0.1, 0.19, 0.0, 0.21, 0.3), references) == [1, 1, 1, 1, 2, 2]
    assert builds((0.0, 0.1, 0.14, 0.0, 0.16), None) == [1, 1, 1, 1, 2]


def test_lists_are_renewed_for_a_wider_selection_and_for_one_far_narrower() -> None:
    renewed, points = Renewed(), square(1, 20)
    built = []
    for reach in (1.0, 0.9, 1.3, 1.31, 0.51, 0.49):
        assert holds_all_within(renewed.reach(points, None, reach), points, points, reach)
        built.append(renewed.builds)
    assert built == [1, 1, 1, 2, 2, 3]


def test_another_number_of_points_has_lists_of_its_own() -> None:
    lists = renew_lists(None, square(1, 20), None, 1.0)
    assert len(renew_lists(lists, square(1, 9), None, 1.0).offsets) == 10
