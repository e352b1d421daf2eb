"""A graph of any keys and kind of pose is as sure of its poses as the same graph of a run."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import A, V
from support.graphs import COVARIANCE, TURNS, graph_of

from mqslam.backend.marginals import Uncertainty
from mqslam.backend.problem import GivenGraph
from mqslam.core import se2
from mqslam.core.measurement import Loop
from mqslam.errors import EstimationError
from mqslam.factors import between
from mqslam.factors.between import PRIOR_M, PRIOR_RAD, lifted_between, prior, psi_between

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
