from __future__ import annotations

import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from mqslam.backend.pose_graph import PoseGraph, chain, marginals, optimise, pose_graph, poses_of
from mqslam.config import GraphConfig
from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.factors.prior import SIGMA_M, SIGMA_RAD
from mqslam.factors.psi_between import psi_between

FLAT = GraphConfig(floor_m=1e-6, floor_rad=1e-6, cancelling=1.0)
COVARIANCE = np.diag([0.01, 0.0025, 1e-4])
TURNS = np.tile([2.0, 0.1, 0.3], (30, 1))  # more than a full turn in all


def graph_of(motions: np.ndarray, initial: np.ndarray, loops: dict[tuple[int, int], np.ndarray] | None = None) -> PoseGraph:
    edges = {(k, k + 1): motion for k, motion in enumerate(motions)} | (loops or {})
    return pose_graph(
        initial,
        [psi_between(X(a), X(b), Measurement(a, b, motion, COVARIANCE), FLAT) for (a, b), motion in edges.items()],
    )


def test_a_chain_makes_one_motion_after_the_other() -> None:
    poses = chain(TURNS, np.array([5.0, -1.0, 0.2]))
    assert poses.shape == (31, 3)
    np.testing.assert_array_equal(poses[0], [5.0, -1.0, 0.2])
    np.testing.assert_allclose(se2.between(poses[:-1], poses[1:]), TURNS, atol=1e-12)
    np.testing.assert_array_equal(chain([]), np.zeros((1, 3)))


def test_without_loops_the_optimum_is_the_chain_wherever_it_starts() -> None:
    truth = chain(TURNS)
    rng = np.random.default_rng(2)
    start = truth + rng.normal(0.0, [0.3, 0.3, 0.03], truth.shape)
    start[0] = truth[0]
    graph = graph_of(TURNS, start)
    assert graph.size == 31
    assert graph.factors.size() == 31
    np.testing.assert_allclose(poses_of(optimise(graph), graph.size), truth, atol=1e-5)


def test_yaw_is_continued_past_a_turn() -> None:
    truth = chain(TURNS)
    found = poses_of(graph_of(TURNS, truth).initial, len(truth))
    assert found[-1, 2] == pytest.approx(9.0)
    assert np.abs(np.diff(found[:, 2])).max() < np.pi


def test_the_first_pose_is_held_where_the_graph_starts() -> None:
    start = chain(TURNS, np.array([5.0, -1.0, 0.2]))
    graph = graph_of(TURNS, start)
    np.testing.assert_allclose(poses_of(optimise(graph), graph.size)[0], start[0], atol=1e-6)


def test_a_loop_shares_the_drift_along_the_way() -> None:
    square = np.tile([[5.0, 0.0, 0.0]] * 4 + [[5.0, 0.0, np.pi / 2.0]], (4, 1))
    drifting = square + np.array([0.02, 0.0, 0.004])
    start, truth = chain(drifting), chain(square)
    loop = {(0, 20): se2.between(truth[0], truth[20])}
    graph = graph_of(drifting, start, loop)
    values = optimise(graph)
    after = poses_of(values, graph.size)
    assert graph.factors.error(values) < 0.1 * graph.factors.error(graph.initial)
    before_m, after_m = (np.hypot(*(p[20, :2] - truth[20, :2])) for p in (start, after))
    assert after_m < 0.2 * before_m
    assert np.abs(se2.between(start[:-1], start[1:]) - se2.between(after[:-1], after[1:])).max() < 0.2


def test_marginals_are_covariances_that_grow_away_from_the_held_pose() -> None:
    graph = graph_of(TURNS, chain(TURNS))
    found = marginals(graph, optimise(graph), [0, 1, 10, 30])
    assert found.shape == (4, 3, 3)
    np.testing.assert_allclose(found, found.transpose(0, 2, 1), atol=1e-12)
    np.testing.assert_array_less(0.0, np.linalg.eigvalsh(found))
    np.testing.assert_allclose(np.sqrt(np.diag(found[0])), [SIGMA_M, SIGMA_M, SIGMA_RAD], rtol=1e-6)
    sizes = np.linalg.det(found)
    assert np.all(np.diff(sizes) > 0.0)


def test_the_marginal_of_the_first_edge_is_its_covariance_in_the_frame_it_ends_in() -> None:
    graph = graph_of(TURNS[:1], chain(TURNS[:1]))
    (found,) = marginals(graph, optimise(graph), [1])
    c, s = np.cos(0.3), np.sin(0.3)
    to_end = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(found, to_end @ COVARIANCE @ to_end.T, atol=2e-6)
