"""Loops around someone's own trajectory are those that a run finds around it, as factors of their own graph."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import A
from support.chains import fenced_street
from support.passes import BEAM, joined, let_passes_follow

from mqslam.backend.loops.closing import find_loops
from mqslam.backend.loops.passes import TrackedRun
from mqslam.backend.problem import Problem
from mqslam.commands.own_graph import loop_factors
from mqslam.commands.work import Work
from mqslam.config import Config, OdometryConfig, SensorConfig
from mqslam.core import se2
from mqslam.core.measurement import Loop, Measurement
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.errors import ConfigError, EstimationError
from mqslam.execution.runner import Runner
from mqslam.factors.between import lifted_between, loop_between, prior, psi_between

# the clock of the drive stops for a minute between its passes, over which odometry is not sure of its yaw
CONFIG = Config(
    sensor=SensorConfig(doppler_beta=0.0),
    odometry=OdometryConfig(sigma_travel=0.02, sigma_yaw_rate=0.0005),
)
OFF_M = 1.0


near_passes = let_passes_follow(50.0)  # each pass of the tests is 58 m long


@pytest.fixture(scope="module")
def street() -> TrackedRun:
    """Two passes over a street; the trajectory has the second one a metre off."""
    first, second = fenced_street(60.0, 1), fenced_street(60.0, 2)
    return joined(first, second, second.poses + np.array([OFF_M, 0.0, 0.0]))


def scans_of(drive: TrackedRun) -> Scans:
    return Scans(tuple(drive.scans), 0, 0.25)


def motions_of(drive: TrackedRun) -> list[Measurement]:
    """Returns the drive's steps as measurements, of which that between the passes is as unsure as it is wrong."""
    motions = []
    for k, motion in enumerate(se2.between(drive.poses[:-1], drive.poses[1:])):
        sigma_m = 1.0 if drive.times[k + 1] - drive.times[k] > 30.0 else 0.02
        covariance = np.diag([sigma_m**2, sigma_m**2, (0.01 * sigma_m) ** 2])
        motions.append(Measurement(float(drive.times[k]), float(drive.times[k + 1]), motion, covariance))
    return motions


def known_loops(drive: TrackedRun) -> list[Loop]:
    """Returns the loops that a run finds."""
    problem = Problem(motions_of(drive), [])
    return find_loops(scans_of(drive), problem, CONFIG.estimator, BEAM, Runner(), recognising=False).loops


def graph_of(drive: TrackedRun, pose: type) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Returns a graph of the drive's steps over the poses a0, a1, ..., and its optimum."""
    graph, values, is_planar = gtsam.NonlinearFactorGraph(), gtsam.Values(), pose is gtsam.Pose2
    held = gtsam.noiseModel.Isotropic.Sigma(6, 1e-3)
    graph.push_back(
        prior(A(0), drive.poses[0])
        if is_planar
        else gtsam.PriorFactorPose3(A(0), gtsam.Pose3(gtsam.Pose2(*drive.poses[0])), held)
    )
    for k, m in enumerate(motions_of(drive)):
        step = psi_between(A(k), A(k + 1), m.pose, m.covariance)
        graph.push_back(step if is_planar else lifted_between(step))
    for k, at in enumerate(drive.poses):
        values.insert(A(k), gtsam.Pose2(*at) if is_planar else gtsam.Pose3(gtsam.Pose2(*at)))
    return graph, values


def assert_same(loops: Sequence[Loop], others: Sequence[Loop], atol: float) -> None:
    """Checks that loops tie the same scans in the same way."""
    assert [(a.earlier, a.later) for a in loops] == [(b.earlier, b.later) for b in others]
    np.testing.assert_allclose([a.pose for a in loops], [b.pose for b in others], atol=atol)


@pytest.mark.parametrize("pose", [gtsam.Pose2, gtsam.Pose3])
def test_a_graph_of_ones_own_gets_the_loops_of_a_run(street: TrackedRun, pose: type) -> None:
    graph, values = graph_of(street, pose)
    pairs = loop_factors(scans_of(street), values, A, graph=graph, config=CONFIG)
    assert len(pairs) >= 5 and graph.size() == len(street.poses)
    assert_same([loop for _, loop in pairs], known_loops(street), 1e-4)
    assert repr(pairs) == f"LoopFactors({len(pairs)} loops)"
    for factor, loop in pairs:
        known = loop_between(A(loop.earlier), A(loop.later), loop)
        expected = known if pose is gtsam.Pose2 else lifted_between(known)
        assert factor.equals(expected, 1e-9)


def test_a_trajectory_alone_is_taken_for_odometry(street: TrackedRun) -> None:
    track = Trajectory(scans_of(street).stamps_us, street.poses)
    pairs = loop_factors(scans_of(street), track, A, config=CONFIG, pose=gtsam.Pose3)
    assert len(pairs) >= 3 and all(isinstance(factor, gtsam.BetweenFactorPose3) for factor, _ in pairs)
    for _, loop in pairs:
        assert loop.pose[0] == pytest.approx(2.0 * (loop.later - 30 - loop.earlier), abs=0.1)
    _, values = graph_of(street, gtsam.Pose2)
    assert_same([b for _, b in loop_factors(scans_of(street), values, A, config=CONFIG)], [b for _, b in pairs], 1e-9)


def test_who_asks_is_told_of_passes_that_could_not_be_tied(street: TrackedRun) -> None:
    told: list[str] = []
    track = Trajectory(scans_of(street).stamps_us, street.poses)
    unsure = CONFIG.model_copy(update={"odometry": OdometryConfig(sigma_yaw_rate=1.0)})
    assert loop_factors(scans_of(street), track, A, config=unsure, work=Work(tell=told.append)) == []
    assert len(told) == 1 and "the search for loops cannot cover the uncertainty" in told[0]


def test_what_cannot_be_meant_is_refused(street: TrackedRun) -> None:
    graph, values = graph_of(street, gtsam.Pose2)
    scans, track = scans_of(street), Trajectory(scans_of(street).stamps_us, street.poses)
    with pytest.raises(ConfigError, match="keys: a text, 'a', holds no keys"):
        loop_factors(scans, track, "a", config=CONFIG)
    with pytest.raises(ConfigError, match=r"graph: comes without the values of its optimum; give gtsam\.Values"):
        loop_factors(scans, track, A, graph=graph, config=CONFIG)
    values.erase(A(7))
    with pytest.raises(ConfigError, match=r"values: holds no pose for scan 7 \(key a7\); give every scan a pose"):
        loop_factors(scans, values, A, graph=graph, config=CONFIG)
    values.insert(A(7), gtsam.Rot2())
    with pytest.raises(ConfigError, match="values: a7, the key of scan 7, holds no pose; give a Pose2 or a Pose3"):
        loop_factors(scans, values, A, graph=graph, config=CONFIG)
    with pytest.raises(EstimationError, match=r"the odometry does not cover 5\.50 s to 5\.75 s"):
        loop_factors(scans, Trajectory(track.stamps_us[:21], track.poses[:21]), A, config=CONFIG)


def test_a_graph_that_nothing_holds_is_refused_in_one_line(street: TrackedRun) -> None:
    graph, values = graph_of(street, gtsam.Pose2)
    graph.remove(0)
    with pytest.raises(EstimationError, match="the graph leaves a direction undetermined"):
        loop_factors(scans_of(street), values, A, graph=graph, config=CONFIG)
