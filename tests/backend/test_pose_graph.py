from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from support.graphs import FLAT, unequal

from mqslam.backend.pose_graph import PoseGraph, build_pose_graph, compute_marginals, optimise, poses_of
from mqslam.core import se2
from mqslam.factors.psi_between import psi_between

COVARIANCE = np.diag([0.01, 0.0025, 1e-4])
TURNS = np.tile([2.0, 0.1, 0.3], (30, 1))  # more than a full turn in all


def graph_of(motions: np.ndarray, initial: np.ndarray, loops: dict[tuple[int, int], np.ndarray] | None = None) -> PoseGraph:
    edges = {(k, k + 1): motion for k, motion in enumerate(motions)} | (loops or {})
    return build_pose_graph(
        initial,
        [psi_between(X(a), X(b), motion, COVARIANCE, FLAT) for (a, b), motion in edges.items()],
        FLAT,
    )


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


def test_marginals_are_covariances_that_grow_away_from_the_held_pose() -> None:
    graph = graph_of(TURNS, se2.chain(TURNS))
    result = compute_marginals(graph, optimise(graph).values, [0, 1, 10, 30])
    assert result.failure is None
    np.testing.assert_array_equal(result.indices, [0, 1, 10, 30])
    np.testing.assert_array_equal(result.covariances, result.covariances.transpose(0, 2, 1))
    np.testing.assert_array_less(0.0, np.linalg.eigvalsh(result.covariances))
    np.testing.assert_allclose(
        np.sqrt(np.diag(result.covariances[0])), [FLAT.prior_m, FLAT.prior_m, FLAT.prior_rad], rtol=1e-6
    )
    assert np.all(np.diff(np.linalg.det(result.covariances)) > 0.0)


def test_the_marginal_of_the_first_edge_is_its_covariance_in_the_frame_it_ends_in() -> None:
    graph = graph_of(TURNS[:1], se2.chain(TURNS[:1]))
    (result,) = compute_marginals(graph, optimise(graph).values, [1]).covariances
    c, s = np.cos(0.3), np.sin(0.3)
    to_end = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(result, to_end @ COVARIANCE @ to_end.T, atol=2e-6)


def dense_marginals(graph: PoseGraph) -> np.ndarray:
    """Returns all marginals (n, 3, 3) by a dense QR decomposition, its rows sorted so that it is as exact as it can be."""
    rows, _ = graph.factors.linearize(graph.initial).jacobian()
    rows = rows[np.argsort(-np.linalg.norm(rows, axis=1))]
    inverse = np.linalg.inv(np.linalg.qr(rows, mode="r"))
    return np.array([inverse[3 * k : 3 * k + 3] @ inverse[3 * k : 3 * k + 3].T for k in range(graph.size)])


@pytest.mark.parametrize("loops", [0, 4])
@pytest.mark.parametrize(("lowest", "highest"), [(-4.0, -2.0), (-10.0, 6.0)])
def test_marginals_are_those_of_a_dense_computation_however_unequal_the_edges(
    loops: int, lowest: float, highest: float
) -> None:
    graph = unequal(20, lowest, highest, loops)
    expected = dense_marginals(graph)
    result = compute_marginals(graph, graph.initial, range(graph.size)).covariances
    sigmas = np.sqrt(np.einsum("kii->ki", expected))
    np.testing.assert_allclose(
        result / (sigmas[:, :, None] * sigmas[:, None, :]), expected / (sigmas[:, :, None] * sigmas[:, None, :]), atol=1e-6
    )


def test_a_long_chain_without_a_known_direction_has_marginals_where_gtsam_has_none() -> None:
    graph = unequal(300, -10.0, 6.0)
    with pytest.raises(RuntimeError, match="Indeterminate linear system"):
        gtsam.Marginals(graph.factors, graph.initial)
    result = compute_marginals(graph, graph.initial, [1, 150, 300])
    assert result.failure is None
    assert np.linalg.eigvalsh(result.covariances).min() > 0.0


@pytest.mark.parametrize(("lowest", "highest"), [(-20.0, 20.0), (-300.0, 300.0)])
def test_marginals_beyond_all_precision_are_said_to_be_unknown(lowest: float, highest: float) -> None:
    graph = unequal(30, lowest, highest)
    result = compute_marginals(graph, graph.initial, [0, 15, 30])
    assert result.failure
    assert result.covariances.shape == (0, 3, 3)
    assert len(result.indices) == 0


def test_marginals_of_a_pose_that_nothing_ties_are_said_to_be_unknown() -> None:
    tied = graph_of(TURNS[:2], se2.chain(TURNS[:2]))
    tied.initial.insert(X(3), gtsam.Pose2())
    loose = PoseGraph(tied.factors, tied.initial, 4)
    assert compute_marginals(loose, loose.initial, [3]).failure == "the graph leaves a direction undetermined"


def test_the_optimum_is_found_however_unequal_the_edges() -> None:
    graph = unequal(200, -10.0, 6.0)
    truth = poses_of(graph.initial, graph.size)
    start = truth + np.random.default_rng(5).normal(0.0, [0.3, 0.3, 0.02], truth.shape)
    start[0] = truth[0]
    moved = build_pose_graph(start, [graph.factors.at(k) for k in range(1, graph.factors.size())], FLAT)
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
