"""A graph is optimised from measurements, or from the factors that someone else has given."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import A, V
from support.graphs import COVARIANCE, TURNS, graph_of, unequal

from mqslam.backend.marginals import Uncertainty
from mqslam.backend.pose_graph import build_pose_graph, optimise, poses_of
from mqslam.backend.problem import GivenGraph
from mqslam.core import se2
from mqslam.core.measurement import Loop
from mqslam.errors import EstimationError
from mqslam.factors import between
from mqslam.factors.between import PRIOR_M, PRIOR_RAD, lifted_between, prior, psi_between


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


CHAIN = se2.chain(TURNS)
PAIRS = [(0, 12), (3, 4), (20, 5)]
LOOP = Loop(2, 25, se2.between(CHAIN[2], CHAIN[25]), 0.1 * COVARIANCE, 0.8, 0.3)


def given_graph(pose: type) -> GivenGraph:
    """Returns a graph of successive motions over the poses a0, a1, ..., and of a speed, which ties to none of them."""
    is_planar = pose is gtsam.Pose2
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    held = gtsam.noiseModel.Diagonal.Sigmas(np.array([PRIOR_RAD] * 3 + [PRIOR_M] * 3))
    factors.push_back(
        prior(A(0), CHAIN[0]) if is_planar else gtsam.PriorFactorPose3(A(0), gtsam.Pose3(gtsam.Pose2(*CHAIN[0])), held)
    )

    def lift(factor: gtsam.BetweenFactorPose2) -> gtsam.NonlinearFactor:
        return factor if is_planar else lifted_between(factor)

    for k, motion in enumerate(TURNS):
        factors.push_back(lift(psi_between(A(k), A(k + 1), motion, COVARIANCE)))
    for k, at in enumerate(CHAIN):
        values.insert(A(k), gtsam.Pose2(*at) if is_planar else gtsam.Pose3(gtsam.Pose2(*at)))
    values.insert(V(0), np.ones(3))
    factors.push_back(gtsam.PriorFactorVector(V(0), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, 1.0)))
    return GivenGraph(factors, values, [A(k) for k in range(len(CHAIN))], lift)


@pytest.mark.parametrize("pose", [gtsam.Pose2, gtsam.Pose3])
def test_relative_covariances_and_poses_are_those_of_a_planar_graph(pose: type) -> None:
    known = graph_of(TURNS, CHAIN)
    graph, optimum = given_graph(pose).optimise([])
    np.testing.assert_allclose(graph.poses_at(optimum.values), CHAIN, atol=1e-6)
    np.testing.assert_allclose(
        Uncertainty(graph, optimum.values).relate(PAIRS),
        Uncertainty(known, known.initial).relate(PAIRS),
        rtol=1e-4,
        atol=1e-7,
    )


@pytest.mark.parametrize("pose", [gtsam.Pose2, gtsam.Pose3])
def test_loops_and_ties_join_the_graph_and_leave_the_given_one_as_it_was(
    pose: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(between, "BEND_SIGMAS", (1e-9, 1e-9, 1e-9))
    given = given_graph(pose)
    size = given.factors.size()
    (before,) = Uncertainty(*_solved(given, [])).relate([(2, 25)])
    for loops, ties in (([LOOP], []), ([], [LOOP])):
        graph, optimum = given.optimise(loops, ties)
        (after,) = Uncertainty(graph, optimum.values).relate([(2, 25)])
        assert np.linalg.det(after) < 0.1 * np.linalg.det(before)
        assert graph.factors.size() == size + 1 and given.factors.size() == size


def test_half_of_a_motion_s_covariance_is_each_of_its_ends_own() -> None:
    own = given_graph(gtsam.Pose2).estimate_own_covariances()
    assert own.shape == (len(CHAIN), 3, 3)
    np.testing.assert_allclose(own[5], 0.5 * COVARIANCE, rtol=1e-6, atol=1e-9)


def test_a_variable_without_a_value_is_an_error_with_a_remedy() -> None:
    given = given_graph(gtsam.Pose2)
    given.values.erase(A(9))
    with pytest.raises(EstimationError, match=r"the graph could not be optimised .*; give values for all its variables"):
        given.optimise([])


def _solved(given: GivenGraph, loops: list[Loop]) -> tuple:
    graph, optimum = given.optimise(loops)
    return graph, optimum.values
