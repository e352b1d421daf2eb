"""The refinement of someone's own graph is that of a run, and comes back as a graph with its optimum."""

from __future__ import annotations

from functools import lru_cache

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import A
from support.passes import BEAM, let_passes_follow, noisy_passes

from mqslam.backend import refinement
from mqslam.backend.pose_graph import poses_of
from mqslam.backend.problem import Problem
from mqslam.backend.sensors.odometry import reckon
from mqslam.commands.own_graph import RefinedGraph, refine
from mqslam.config import Config, SensorConfig
from mqslam.core.measurement import Loop, Refined
from mqslam.core.scans import Scans
from mqslam.errors import EstimationError
from mqslam.execution.runner import Runner
from mqslam.factors.between import loop_between, prior, psi_between

CONFIG = Config(sensor=SensorConfig(doppler_beta=0.0))
LAST = 19  # the last scan of the first pass


near_passes = let_passes_follow(35.0)  # each pass of the tests is 40 m long


def two_passes() -> tuple[Scans, Problem, Loop]:
    """Returns the scans of two passes over a street, a problem of noisy motions along them, and a loop that is off."""
    drive, problem, loop = noisy_passes()
    return Scans(tuple(drive.scans), 0, 0.25), problem, loop


@lru_cache(maxsize=1)
def known() -> Refined:
    """Returns what a run makes of the passes."""
    scans, problem, loop = two_passes()
    before = reckon(scans, problem.measurements)
    return refinement.refine(before, problem, [loop], scans, 1, CONFIG.estimator, BEAM, Runner())


def own_graph() -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Returns the graph of the motions over the poses a0, a1, ..., and where they lead."""
    scans, problem, _ = two_passes()
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(prior(A(0), np.zeros(3)))
    for k, m in enumerate(problem.measurements):
        graph.push_back(psi_between(A(k), A(k + 1), m.pose, m.covariance))
    for k, pose in enumerate(reckon(scans, problem.measurements).poses):
        values.insert(A(k), gtsam.Pose2(*pose))
    return graph, values


@lru_cache(maxsize=1)
def refined() -> RefinedGraph:
    """Returns the refinement of that graph."""
    scans, _, loop = two_passes()
    graph, values = own_graph()
    loops = [(loop_between(A(loop.earlier), A(loop.later), loop), loop)]
    return refine(graph, values, scans, A, loops=loops, rounds=1, config=CONFIG)


def test_the_ties_are_those_of_a_run() -> None:
    ties = [tie for _, tie in refined().ties]
    assert [(a.earlier, a.later) for a in ties] == [(b.earlier, b.later) for b in known().ties]
    assert len(ties) >= 10
    np.testing.assert_allclose([a.pose for a in ties], [b.pose for b in known().ties], atol=1e-3)
    seen = [(a, b) for a, b in zip(ties, known().ties, strict=True) if a.earlier != LAST]
    np.testing.assert_allclose([a.covariance for a, _ in seen], [b.covariance for _, b in seen], rtol=0.05, atol=1e-6)
    assert refined().psi_after == pytest.approx(known().psi_across, rel=1e-3)


def test_a_scan_before_a_motion_that_nobody_saw_is_as_sure_as_the_scan_before_it_tells() -> None:
    own = [tie.covariance[0, 0] for _, tie in refined().ties if tie.earlier == LAST]
    others = [tie.covariance[0, 0] for _, tie in refined().ties if tie.earlier != LAST]
    assert own and max(own) < 2.0 * max(others)


def test_ties_take_the_place_of_loops_in_the_graph_that_comes_back() -> None:
    result, (given, _) = refined(), own_graph()
    assert result.loops == []
    assert result.graph.size() == given.size() + len(result.ties)
    factor, tie = result.ties[0]
    assert result.graph.at(given.size()).equals(factor, 1e-9) and list(factor.keys()) == [A(tie.earlier), A(tie.later)]


def test_the_values_that_come_back_are_the_optimum_and_lie_better() -> None:
    result, (_, start) = refined(), own_graph()
    scans, problem, _ = two_passes()
    poses = problem.solve_poses(known().loops, known().ties)
    np.testing.assert_allclose(poses_of(result.values, len(scans), A), poses, atol=0.03)
    assert result.graph.error(result.values) < 0.5 * result.graph.error(start)
    assert result.psi_before is not None and result.psi_loops is not None and result.psi_after is not None
    assert result.psi_after < result.psi_loops < result.psi_before
    assert repr(result).startswith(f"<RefinedGraph, 0 loops, {len(result.ties)} ties, psi ") and len(repr(result)) < 80


def test_without_loops_the_graph_is_optimised_and_nothing_is_tied() -> None:
    scans, _, _ = two_passes()
    graph, values = own_graph()
    result = refine(graph, values, scans, A, loops=[], config=CONFIG)
    assert result.ties == result.loops == [] and result.graph.equals(graph, 1e-9)


def test_values_that_are_missing_are_told_in_one_line() -> None:
    scans, _, _ = two_passes()
    graph, values = own_graph()
    graph.push_back(psi_between(A(3), 77, np.zeros(3), np.eye(3)))
    with pytest.raises(EstimationError, match=r"the graph could not be optimised .* give values for all its variables"):
        refine(graph, values, scans, A, loops=[], config=CONFIG)
