from __future__ import annotations

import numpy as np
import pytest
from support.graphs import TURNS, graph_of, unequal

from mqslam.backend.pose_graph import build_pose_graph, optimise, poses_of
from mqslam.core import se2


def test_without_loops_the_optimum_is_the_chain_wherever_it_starts() -> None:
    truth = se2.chain(TURNS)
    rng = np.random.default_rng(2)
    start = truth + rng.normal(0.0, [0.3, 0.3, 0.03], truth.shape)
    start[0] = truth[0]
    graph = graph_of(TURNS, start)
    assert graph.size == 31
    assert graph.factors.size() == 31
    np.testing.assert_allclose(poses_of(optimise(graph).values, graph.size), truth, atol=1e-5)


def test_yaw_is_continued_past_a_turn() -> None:
    truth = se2.chain(TURNS)
    result = poses_of(graph_of(TURNS, truth).initial, len(truth))
    assert result[-1, 2] == pytest.approx(9.0)
    assert np.abs(np.diff(result[:, 2])).max() < np.pi


def test_the_first_pose_is_held_where_the_graph_starts() -> None:
    start = se2.chain(TURNS, np.array([5.0, -1.0, 0.2]))
    graph = graph_of(TURNS, start)
    np.testing.assert_allclose(poses_of(optimise(graph).values, graph.size)[0], start[0], atol=1e-6)


def test_a_loop_shares_the_drift_along_the_way() -> None:
    square = np.tile([[5.0, 0.0, 0.0]] * 4 + [[5.0, 0.0, np.pi / 2.0]], (4, 1))
    drifting = square + np.array([0.02, 0.0, 0.004])
    start, truth = se2.chain(drifting), se2.chain(square)
    loop = {(0, 20): se2.between(truth[0], truth[20])}
    graph = graph_of(drifting, start, loop)
    values = optimise(graph).values
    after = poses_of(values, graph.size)
    assert graph.factors.error(values) < 0.1 * graph.factors.error(graph.initial)
    before_m, after_m = (np.hypot(*(p[20, :2] - truth[20, :2])) for p in (start, after))
    assert after_m < 0.2 * before_m
    assert np.abs(se2.between(start[:-1], start[1:]) - se2.between(after[:-1], after[1:])).max() < 0.2


def test_the_optimum_is_found_however_unequal_the_edges() -> None:
    graph = unequal(200, -10.0, 6.0)
    truth = poses_of(graph.initial, graph.size)
    start = truth + np.random.default_rng(5).normal(0.0, [0.3, 0.3, 0.02], truth.shape)
    start[0] = truth[0]
    moved = build_pose_graph(start, [graph.factors.at(k) for k in range(1, graph.factors.size())])
    optimum = optimise(moved)
    assert optimum.failure is None
    assert moved.factors.error(optimum.values) < 1e-3  # of some 1e13 where it starts; by Cholesky's method over 1 is left


@pytest.mark.parametrize("broken", ["a factor of a pose that is not there", "beyond numbers"])
def test_a_graph_that_cannot_be_optimised_keeps_its_starting_values(broken: str) -> None:
    graph = graph_of(TURNS, se2.chain(TURNS))
    if broken == "a factor of a pose that is not there":
        graph.factors.push_back(graph_of(np.tile(TURNS, (2, 1)), se2.chain(np.tile(TURNS, (2, 1)))).factors.at(40))
    else:
        far = se2.chain(TURNS)
        far[20, 0] = np.inf
        graph = graph_of(TURNS, far)
    optimum = optimise(graph)
    assert optimum.failure
    assert optimum.values is graph.initial
