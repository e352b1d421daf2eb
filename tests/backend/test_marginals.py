"""Covariances of poses, and of one pose in the frame of another, are those of a dense computation, or said to be unknown."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import M, X
from support.graphs import COVARIANCE, FLAT, TURNS, graph_of, unequal

from mqslam.backend.marginals import compute_marginals, compute_relative_covariances
from mqslam.backend.pose_graph import PoseGraph, optimise
from mqslam.core import se2
from mqslam.errors import EstimationError


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


def dense_relative(graph: PoseGraph, a: int, b: int) -> np.ndarray:
    """Returns the covariance (3, 3) of pose b in the frame of pose a, by numerical derivatives and a dense inverse."""
    rows, _ = graph.factors.linearize(graph.initial).jacobian()
    widths = {key: len(graph.initial.zeroVectors().at(key)) for key in graph.factors.keyVector()}
    places = {k: sum(width for key, width in widths.items() if key < X(k)) for k in (a, b)}

    def motion(change: np.ndarray) -> np.ndarray:
        poses = (graph.initial.atPose2(X(k)).retract(change[at : at + 3]) for k, at in places.items())
        return se2.between(*([pose.x(), pose.y(), pose.theta()] for pose in poses))

    step = 1e-6 * np.eye(rows.shape[1])
    derivative = np.column_stack([(motion(nudge) - motion(-nudge)) / 2e-6 for nudge in step])
    return derivative @ np.linalg.inv(rows.T @ rows) @ derivative.T


PAIRS = [(3, 9), (0, 20), (12, 5), (19, 20)]


@pytest.mark.parametrize("loops", [0, 4])
def test_relative_covariances_are_those_of_a_dense_computation(loops: int) -> None:
    graph = unequal(20, -4.0, -2.0, loops)
    for pair, result in zip(PAIRS, compute_relative_covariances(graph, graph.initial, PAIRS), strict=True):
        np.testing.assert_allclose(result, dense_relative(graph, *pair), rtol=1e-5, atol=1e-9)


def test_the_relative_covariance_over_one_edge_is_that_of_the_edge() -> None:
    graph = graph_of(TURNS, se2.chain(TURNS))
    (result,) = compute_relative_covariances(graph, graph.initial, [(25, 26)])
    np.testing.assert_allclose(result, COVARIANCE, atol=1e-9)


def with_submaps(graph: PoseGraph) -> PoseGraph:
    """Returns the graph with a scalar and further poses in it, the keys of which sort before those of its poses."""
    noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.05)
    for k in range(0, graph.size - 1, 5):
        graph.initial.insert(M(k), graph.initial.atPose2(X(k)))
        for x in range(k, min(k + 6, graph.size)):
            motion = graph.initial.atPose2(X(k)).between(graph.initial.atPose2(X(x)))
            graph.factors.push_back(gtsam.BetweenFactorPose2(M(k), X(x), motion, noise))
    graph.initial.insert(gtsam.symbol("a", 0), 1.0)
    graph.factors.push_back(gtsam.PriorFactorDouble(gtsam.symbol("a", 0), 1.0, gtsam.noiseModel.Isotropic.Sigma(1, 0.1)))
    return graph


def test_variables_besides_the_poses_may_be_in_the_graph() -> None:
    graph = with_submaps(unequal(20, -4.0, -2.0, 2))
    for pair, result in zip(PAIRS, compute_relative_covariances(graph, graph.initial, PAIRS), strict=True):
        np.testing.assert_allclose(result, dense_relative(graph, *pair), rtol=1e-5, atol=1e-9)
    marginals = gtsam.Marginals(graph.factors, graph.initial)
    for k, result in zip([0, 7, 20], compute_marginals(graph, graph.initial, [0, 7, 20]).covariances, strict=True):
        np.testing.assert_allclose(result, marginals.marginalCovariance(X(k)), rtol=1e-5, atol=1e-12)


def test_relative_covariances_beyond_all_precision_are_an_error() -> None:
    graph = unequal(30, -300.0, 300.0)
    with pytest.raises(EstimationError):
        compute_relative_covariances(graph, graph.initial, [(0, 30)])


def test_no_pairs_have_no_covariances() -> None:
    graph = graph_of(TURNS, se2.chain(TURNS))
    assert compute_relative_covariances(graph, graph.initial, []).shape == (0, 3, 3)
