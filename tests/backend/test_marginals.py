"""Covariances of poses, and of poses relative to each other, are those of the graph, or are refused."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import M, X
from support.chains import chain_of
from support.graphs import COVARIANCE, TURNS, graph_of, unequal
from support.passes import path

from mqslam.backend.marginals import (
    GraphCovariances,
    SingleCovariances,
    Uncertainty,
    compute_all_marginals,
    measure_scale_error,
)
from mqslam.backend.pose_graph import PoseGraph, optimise
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


def test_an_error_of_the_scale_stretches_all_relative_poses() -> None:
    sigma = 0.003
    without = graph_of(TURNS, se2.chain(TURNS))
    poses, pairs = se2.chain(TURNS), [(0, 30), (5, 26)]
    scaled = replace(without, scale_sigma=sigma)
    for (a, b), before, after in zip(
        pairs, *(Uncertainty(graph, graph.initial).relate(pairs) for graph in (without, scaled)), strict=True
    ):
        stretch = sigma * se2.between(poses[a], poses[b]) * [1.0, 1.0, 0.0]
        np.testing.assert_allclose(after, before + np.outer(stretch, stretch), rtol=1e-6, atol=1e-9)


def test_positions_that_another_sensor_measures_show_the_scale() -> None:
    motions = [motion * [1.01, 1.01, 1.0] for motion in TURNS]
    graph = replace(graph_of(TURNS, se2.chain(TURNS)), scale_sigma=0.05)
    noise = gtsam.noiseModel.Isotropic.Sigma(2, 0.01)
    for k, pose in enumerate(se2.chain(motions)):
        graph.factors.push_back(gtsam.PoseTranslationPrior2D(X(k), gtsam.Pose2(*pose), noise))
    error, sigma = measure_scale_error(graph, optimise(graph).values)
    assert error == pytest.approx(0.01, abs=0.001) and sigma < 0.01


def test_relative_covariances_beyond_all_precision_are_an_error() -> None:
    graph = unequal(30, -300.0, 300.0)
    with pytest.raises(EstimationError):
        Uncertainty(graph, graph.initial).relate([(0, 30)])


def test_no_pairs_have_no_covariances() -> None:
    graph = graph_of(TURNS, se2.chain(TURNS))
    assert Uncertainty(graph, graph.initial).relate([]).shape == (0, 3, 3)


SIGMAS = (0.05, 0.02, 0.004)
PAIR = (12, 38)


def drive_round() -> np.ndarray:
    """Returns places (N, 2) [m] of a drive around a circle and on."""
    angles = np.linspace(0.0, 2.5 * np.pi, 50)
    return 20.0 * np.column_stack([np.sin(angles), -np.cos(angles)])


def draw_errors(poses: np.ndarray, count: int) -> np.ndarray:
    """Returns how far (count, 3) the later pose of the pair is off the earlier one, in its own frame, if steps err."""
    rng, a, b = np.random.default_rng(3), *PAIR
    steps = [se2.between(poses[k], poses[k + 1]) for k in range(a, b)]
    truth = se2.between(poses[a], poses[b])
    drawn = [se2.chain([se2.compose(s, rng.normal(0.0, SIGMAS)) for s in steps])[-1] for _ in range(count)]
    return np.array([se2.between(truth, one) for one in drawn])


def test_a_graph_claims_what_its_edges_leave() -> None:
    chain = chain_of(path(drive_round()), SIGMAS)
    poses = chain.drive.poses
    stated = GraphCovariances(chain.graph, chain.values, range(len(poses)), poses)
    related = stated.relate([PAIR])
    assert related is not None
    errors = draw_errors(poses, 4000)
    np.testing.assert_allclose(np.sqrt(np.diag(related[0])), errors.std(axis=0), rtol=0.06)
    whitened = np.linalg.solve(np.linalg.cholesky(related[0]), errors.T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(3), atol=0.15)


def test_numbers_tell_which_poses_of_the_graph_are_judged() -> None:
    chain = chain_of(path(drive_round()), SIGMAS)
    some = [5, 12, 20, 38]
    few = GraphCovariances(chain.graph, chain.values, some, chain.drive.poses[some]).relate([(1, 3)])
    every = GraphCovariances(chain.graph, chain.values, range(50), chain.drive.poses).relate([PAIR])
    np.testing.assert_allclose(few, every, rtol=1e-9)


def test_single_poses_never_claim_more_than_the_graph_knows() -> None:
    chain = chain_of(path(drive_round()), SIGMAS)
    poses = chain.drive.poses
    pairs = [(5, 20), PAIR, (2, 49)]
    exact = GraphCovariances(chain.graph, chain.values, range(len(poses)), poses).relate(pairs)
    assert exact is not None
    marginals = compute_all_marginals(chain.graph, chain.values)
    bounds = SingleCovariances(marginals.covariances, poses).relate(pairs)
    for bound, one in zip(bounds, exact, strict=True):
        assert np.linalg.eigvalsh(bound - one)[0] > -1e-9
    from_first = SingleCovariances(marginals.covariances, poses).relate([(0, 30)])
    first = GraphCovariances(chain.graph, chain.values, range(len(poses)), poses).relate([(0, 30)])
    np.testing.assert_allclose(from_first, first, rtol=1e-3, atol=1e-7)  # nothing is in common with a pose that is held


def test_a_graph_that_leaves_a_pose_undetermined_claims_nothing() -> None:
    chain = chain_of(path(drive_round()), SIGMAS)
    values = gtsam.Values(chain.values)
    values.insert(X(50), gtsam.Pose2(0.0, 0.0, 0.0))
    poses = np.vstack([chain.drive.poses, np.zeros(3)])
    assert GraphCovariances(chain.graph, values, range(51), poses).relate([(3, 50)]) is None
