"""Covariances of one pose in the frame of another are those of a dense computation, or there is an error."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import M, X
from support.graphs import COVARIANCE, TURNS, graph_of, unequal

from mqslam.backend.marginals import Uncertainty
from mqslam.backend.pose_graph import PoseGraph
from mqslam.core import se2
from mqslam.errors import EstimationError


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
    for pair, result in zip(PAIRS, Uncertainty(graph, graph.initial).relate(PAIRS), strict=True):
        np.testing.assert_allclose(result, dense_relative(graph, *pair), rtol=1e-5, atol=1e-9)


def test_the_relative_covariance_over_one_edge_is_that_of_the_edge() -> None:
    graph = graph_of(TURNS, se2.chain(TURNS))
    (result,) = Uncertainty(graph, graph.initial).relate([(25, 26)])
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
    for pair, result in zip(PAIRS, Uncertainty(graph, graph.initial).relate(PAIRS), strict=True):
        np.testing.assert_allclose(result, dense_relative(graph, *pair), rtol=1e-5, atol=1e-9)


def test_relative_covariances_beyond_all_precision_are_an_error() -> None:
    graph = unequal(30, -300.0, 300.0)
    with pytest.raises(EstimationError):
        Uncertainty(graph, graph.initial).relate([(0, 30)])


def test_no_pairs_have_no_covariances() -> None:
    graph = graph_of(TURNS, se2.chain(TURNS))
    assert Uncertainty(graph, graph.initial).relate([]).shape == (0, 3, 3)
