from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.clouds import TURN_S, point_set
from support.score_reference import evaluate_reference

from mqslam.psi.neighbours import find_candidates, list_near, sort_into_cells
from mqslam.psi.place import PointSet
from mqslam.psi.score import Kernel, PsiEvaluation, Scale, evaluate, make_references

SCALE = Scale(s=1.5, beta_s=0.6, c=2.0)
KERNEL = Kernel(revolution_s=TURN_S, beta_t=0.06, xi=0.02, blur=0.15, aspect=0.05, apart_share=0.3, apart_blur=0.3)


def look(points: PointSet, seed: int) -> PointSet:
    """Returns the points as seen from directions of their own, some of them alike within the kernel's aspect."""
    angles = np.random.default_rng([seed, 2]).normal(0.0, 2.0 * KERNEL.aspect, len(points))
    return replace(points, rays=np.column_stack([np.cos(angles), np.sin(angles)]))


def evaluated(queries: PointSet, references: PointSet, scale: Scale = SCALE, more: float = 0.0) -> PsiEvaluation:
    if queries is references:
        lists = find_candidates(sort_into_cells(references.points, 1.0), queries.points, scale.s + more)
        return evaluate(queries, None, scale, KERNEL, lists)
    fixed = make_references(references)
    return evaluate(queries, fixed, scale, KERNEL, list_near(fixed.grid, queries.points, scale.s + more))


def assert_equal(one: PsiEvaluation, other: PsiEvaluation, rtol: float = 1e-9) -> None:
    np.testing.assert_array_equal(one.matched, other.matched)
    for name in ("shares", "scores", "information", "curvature"):
        there = getattr(other, name)
        np.testing.assert_allclose(
            getattr(one, name), there, rtol=rtol, atol=rtol * np.abs(there).max(initial=0.0), err_msg=name
        )
    assert one.psi == pytest.approx(other.psi, rel=rtol)


@given(
    seed=st.integers(0, 2**32 - 2),
    counts=st.tuples(st.integers(0, 30), st.integers(0, 30)),
    side=st.sampled_from([1.0, 5.0, 40.0]),
    moving=st.booleans(),
    looks=st.tuples(st.booleans(), st.booleans()),
    parameters=st.sampled_from([0, 2, 6]),
    scale=st.sampled_from([SCALE, Scale(0.7, 0.3, 2.0), Scale(2.5, 1.25, 5.0)]),
)
@settings(max_examples=150, deadline=None)
def test_the_kernel_equals_the_reference(
    seed: int,
    counts: tuple[int, int],
    side: float,
    moving: bool,
    looks: tuple[bool, bool],
    parameters: int,
    scale: Scale,
) -> None:
    """Both point sets know the directions that they were seen from, or one of them does, or none."""
    sets = [point_set(seed + k, count, side, parameters) for k, count in enumerate(counts)]
    queries, other = (look(points, seed + k) if looks[k] else points for k, points in enumerate(sets))
    references = queries if moving else other
    if not moving:  # a map has no jacobians
        references = replace(references, jacobians=np.zeros((0, 2, 0)))
    reference = evaluate_reference(queries, references, scale, KERNEL, moving_references=moving)
    assert_equal(evaluated(queries, references, scale), reference)
    if not moving:
        for cell_m in (0.6, 2.0):
            assert_equal(evaluate(queries, make_references(references, cell_m), scale, KERNEL), reference)


def test_references_in_more_cells_than_are_listed_give_the_same_score() -> None:
    """Two crowds far apart from each other leave so many empty cells that their points are searched for."""
    queries, near = look(point_set(1, 300), 1), look(point_set(2, 2000), 2)
    far = replace(near, points=near.points + 3000.0)
    both = replace(
        near,
        points=np.concatenate([near.points, far.points]),
        times=np.tile(near.times, 2),
        covariances=np.tile(near.covariances, (2, 1)),
        rays=np.tile(near.rays, (2, 1)),
        jacobians=np.zeros((0, 2, 0)),
    )
    references = make_references(both)
    assert len(references.grid.firsts) == 0 and len(make_references(near).grid.firsts) > 0
    expected = evaluate(queries, make_references(near), SCALE, KERNEL)
    assert expected.matched.sum() > 200
    assert_equal(evaluate(queries, references, SCALE, KERNEL), expected, rtol=1e-12)


def test_the_comparison_is_of_crowded_neighbourhoods_too() -> None:
    queries, references = look(point_set(1, 200), 1), look(point_set(2, 200), 2)
    for others in (queries, references):
        evaluation = evaluated(queries, others)
        assert 150 < evaluation.matched.sum() <= 200
        moving = others is queries
        assert_equal(evaluation, evaluate_reference(queries, others, SCALE, KERNEL, moving_references=moving))


def test_points_without_a_neighbour_are_charged_and_pull_nowhere() -> None:
    queries, references = point_set(1, 10), point_set(2, 10)
    far = replace(references, points=references.points + 100.0)
    for others in (far, point_set(2, 0)):
        evaluation = evaluated(queries, others)
        assert not evaluation.matched.any()
        np.testing.assert_array_equal(evaluation.shares, np.full(10, SCALE.c**2))
        np.testing.assert_array_equal(evaluation.gradient, np.zeros(3))
        np.testing.assert_array_equal(evaluation.curvature, np.zeros((3, 3)))


@given(seed=st.integers(0, 2**32 - 2), side=st.sampled_from([1.0, 5.0, 40.0]))
@settings(max_examples=50, deadline=None)
def test_no_point_costs_more_than_an_unmatched_one(seed: int, side: float) -> None:
    evaluation = evaluated(point_set(seed, 30, side), point_set(seed + 1, 30, side))
    assert np.all(evaluation.shares >= 0.0)
    assert np.all(evaluation.shares <= SCALE.c**2 * (1.0 + 1e-12))


def one_pair(apart: float, times: tuple[float, float] = (0.0, 1.0)) -> tuple[PointSet, PointSet]:
    """Returns a query at the origin and a reference beside it, both of unit covariance less the blur's."""

    def single(x: float, t: float) -> PointSet:
        own = 0.5 * (1.0 - KERNEL.blur**2)
        return PointSet(np.array([[x, 0.0]]), np.eye(2)[None], np.array([[own, 0.0, own]]), np.array([t]))

    return single(0.0, times[0]), single(apart, times[1])


def test_a_pair_costs_what_the_chain_of_equations_says_and_never_less_for_lying_farther_apart() -> None:
    wide = Scale(10.0, 10.0, 2.0)
    for d in (0.0, 0.5, 2.0, 4.0):
        evaluation = evaluated(*one_pair(d), wide)
        assert evaluation.shares[0] == pytest.approx(d**2 / (1.0 + d**2 / 4.0))
        assert evaluation.scores[0] == pytest.approx([-d / (1.0 + d**2 / 4.0) ** 2, 0.0])
    shares = [evaluated(*one_pair(d), wide).shares[0] for d in np.linspace(0.0, 9.0, 19)]
    assert np.all(np.diff(shares) > 0.0)


@pytest.mark.parametrize(("apart_s", "matched"), [(0.0, False), (0.05, False), (0.2, True), (0.25, True), (90.0, True)])
def test_only_neighbours_about_a_turn_apart_or_more_take_part(apart_s: float, matched: bool) -> None:
    for times in ((10.0, 10.0 + apart_s), (10.0 + apart_s, 10.0)):
        assert evaluated(*one_pair(0.1, times)).matched[0] == matched


def test_a_neighbour_takes_part_while_its_kappa_reaches_xi_and_it_lies_within_s() -> None:
    reach = SCALE.beta_s * np.sqrt(-np.log(KERNEL.xi))
    assert reach < SCALE.s
    assert [evaluated(*one_pair(f * reach)).matched[0] for f in (0.999, 1.001)] == [True, False]
    wide = SCALE._replace(beta_s=10.0)
    assert [evaluated(*one_pair(f * wide.s), wide).matched[0] for f in (0.999, 1.001)] == [True, False]


def seen_from(points: PointSet, *angles: float) -> PointSet:
    """Returns the points as seen along rays at these angles [rad]."""
    return replace(points, rays=np.array([[np.cos(angle), np.sin(angle)] for angle in angles]))


@pytest.mark.parametrize(
    ("apart_rad", "blur"), [(0.0, KERNEL.blur), (KERNEL.aspect, None), (1.0, KERNEL.apart_blur), (np.pi, KERNEL.apart_blur)]
)
def test_a_neighbour_is_surer_the_more_alike_the_directions_are_that_the_two_were_seen_from(
    apart_rad: float, blur: float | None
) -> None:
    query, reference = one_pair(0.0)
    evaluation = evaluated(seen_from(query, 2.0), seen_from(reference, 2.0 + apart_rad))
    likeness = np.exp(-1.0)  # at the aspect
    squared = likeness * KERNEL.blur**2 + (1.0 - likeness) * KERNEL.apart_blur**2 if blur is None else blur**2
    assert evaluation.information[0, 0] == pytest.approx(1.0 / (1.0 - KERNEL.blur**2 + squared), rel=1e-4)


def test_of_two_neighbours_the_one_seen_from_the_same_direction_counts_more() -> None:
    query, beside = one_pair(0.2)
    pair = replace(
        beside,
        points=np.array([[0.2, 0.0], [-0.2, 0.0]]),
        covariances=np.tile(beside.covariances, (2, 1)),
        times=np.full(2, 1.0),
    )
    evaluation = evaluated(seen_from(query, 2.0), seen_from(pair, 2.0, 3.0))
    share = KERNEL.apart_share
    centroid = 0.2 * (1.0 - share) / (1.0 + share)
    squared = (KERNEL.blur**2 + share * KERNEL.apart_blur**2) / (1.0 + share)
    d2 = centroid**2 / (1.0 - KERNEL.blur**2 + squared)
    assert evaluation.shares[0] == pytest.approx(d2 / (1.0 + d2 / SCALE.c**2))
    assert evaluation.scores[0, 0] < 0.0  # psi falls towards the neighbour at +0.2 m


def test_where_one_point_set_does_not_know_its_directions_all_views_count_the_same() -> None:
    queries, references = point_set(1, 100), point_set(2, 100)
    blind = evaluated(queries, references)
    assert_equal(evaluated(look(queries, 1), references), blind)
    assert_equal(evaluated(queries, look(references, 2)), blind)
    assert abs(evaluated(look(queries, 1), look(references, 2)).psi - blind.psi) > 0.01 * blind.psi


def test_the_scores_are_half_the_gradient_of_the_shares() -> None:
    """With one neighbour a point nothing is re-selected."""
    lattice = 10.0 * np.array([[k % 8, k // 8] for k in range(40)])
    queries = replace(point_set(4, 40, parameters=5), points=lattice)
    near = lattice + np.random.default_rng(4).normal(0.0, 0.1, (40, 2))
    references = replace(point_set(5, 40), points=near, times=queries.times + 1.0)

    def losses(theta: np.ndarray) -> np.ndarray:
        return evaluated(replace(queries, points=queries.points + queries.jacobians @ theta), references).shares

    evaluation = evaluated(queries, references)
    small = evaluation.shares < 0.9 * SCALE.c**2
    assert evaluation.matched.all()
    assert small.sum() > 30
    step = 1e-6
    for p in range(5):
        up, down = (losses(sign * step * np.eye(5)[p]) for sign in (1.0, -1.0))
        difference = 0.5 * (up - down) / (2.0 * step)
        within = small & (np.abs(evaluation.scores[:, p]) > 1e-3)
        np.testing.assert_allclose(difference[within], evaluation.scores[within, p], rtol=1e-4)


def test_the_curvature_knows_that_neighbours_are_selected_anew_as_a_point_moves() -> None:
    around = np.array([[0.3, 0.1], [-0.3, -0.1], [0.1, -0.4], [-0.1, 0.4]])  # their centroid is the query: L = 1, e = 0
    query, _ = one_pair(0.0)
    references = PointSet(around, np.zeros((0, 2, 0)), np.tile([0.05, 0.01, 0.02], (4, 1)), np.full(4, 1.0))
    evaluation = evaluated(query, references)
    step = 1e-6
    slope = np.empty((2, 2))
    for p in range(2):
        up, down = (
            evaluated(replace(query, points=query.points + sign * step * np.eye(2)[p]), references).gradient
            for sign in (1.0, -1.0)
        )
        slope[:, p] = (up - down) / (2.0 * step)
    np.testing.assert_allclose(evaluation.curvature, 0.5 * (slope + slope.T), rtol=1e-6)
    np.testing.assert_array_less(np.linalg.eigvalsh(evaluation.curvature), 0.8 * np.linalg.eigvalsh(evaluation.information))


def test_lists_that_hold_more_than_needed_give_the_same_score() -> None:
    queries, references = point_set(1, 100), point_set(2, 100)
    assert_equal(evaluated(queries, references, more=2.0), evaluated(queries, references), rtol=1e-12)
