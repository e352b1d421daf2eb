"""Factors of loop closures for a GTSAM graph of one's own."""

from __future__ import annotations

from pathlib import Path

import gtsam
from gtsam.symbol_shorthand import X

from mqslam.backend.loops.closing import find_loops
from mqslam.backend.problem import GivenGraph, GraphProblem, Problem
from mqslam.backend.sensors.odometry import ODOMETRY
from mqslam.commands.graphs.keys import Between, Keys, Pose, choose_lift, find_pose_kind, list_keys, read_poses
from mqslam.commands.graphs.radar import Radar, Source, look_at
from mqslam.commands.work import QUIET, Work
from mqslam.config import Config
from mqslam.core.frontend import measure_motions
from mqslam.core.measurement import Loop
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.errors import ConfigError
from mqslam.factors.between import loop_between


class LoopFactors(list[tuple[Between, Loop]]):
    """The factors of loop closures, each with the loop that it states."""

    def __repr__(self) -> str:
        return f"LoopFactors({count_of(len(self), 'loop')})"


def loop_factors(
    recording: Source,
    trajectory: Trajectory | gtsam.Values,
    keys: Keys = X,
    *,
    graph: gtsam.NonlinearFactorGraph | None = None,
    config: Config | Path | str | None = None,
    pose: Pose = gtsam.Pose2,
    work: Work = QUIET,
) -> LoopFactors:
    """Searches a recording for loop closures around a trajectory, as a run does, and returns their factors.

    Passes of a place are compared as far around the trajectory as it may be wrong. A loop is a match by psi that the
    trajectory allows, that fits nowhere else, that agrees with its neighbours, and that makes the map of its two passes
    better. How far the trajectory may be wrong is told by the graph whose optimum it is. Without a graph its steps are taken
    to be as good as odometry states itself (`odometry.sigma_travel`, `sigma_yaw_rate` and `sigma_rest_m` of the settings),
    as in a run with the front end `odometry`. A good trajectory is surer than that over a long way, and passes are left out
    that odometry would not know well enough.

    Args:
        recording: a recording's path, the open recording, or its scans, such as those of `psi_factors`.
        trajectory: poses of the sensor over time that cover the recording, or values with a pose (`gtsam.Pose2` or
            `gtsam.Pose3`) for the start of every scan.
        keys: GTSAM's key of the pose of each scan by its number (0, 1, ...): a function, or a sequence with a key for
            each; by default `gtsam.symbol("x", k)`.
        graph: all factors of the values but those of loops; they determine every variable. It is not changed.
        config: settings, or the path of a YAML file, or the name of one that ships with mqslam; None takes the defaults.
            Loops are looked for whatever `loops.enabled` says.
        pose: what the poses of the graph are, where no values tell it: `gtsam.Pose2`, or `gtsam.Pose3`, whose factors state
            weak noise on z (0.1 m), roll and pitch (0.03 rad).
        work: where the work is done, and who is told about it, also about pairs of passes that could not be tied.

    Returns:
        A list with a (factor, loop) for each loop. The loop holds the numbers of its two scans, and the pose of the later
        one in the frame of the earlier one with its covariance [m, m, rad]. To that the factor adds what submaps bend
        (0.05 m, 0.0015 rad), and a Cauchy loss that keeps a wrong loop from bending the graph.

    Raises:
        ConfigError: a key, a value or a setting is wrong.
        DataError: the recording cannot be used.
        EstimationError: the trajectory does not cover the recording, or the graph does not determine it.

    Example:
        >>> for factor, loop in mqslam.loop_factors("drive", values, keys, graph=graph):  # doctest: +SKIP
        ...     closed.push_back(factor)
    """
    with look_at(recording, config, work) as radar:
        settings, scans, runner = radar.config, radar.scans, radar.runner
        listed = list_keys(keys, len(scans))
        if isinstance(trajectory, gtsam.Values):
            poses = read_poses(trajectory, listed)
            pose = find_pose_kind(trajectory, listed[0])
        lift = choose_lift(pose)
        problem: GraphProblem
        if graph is None:
            track = Trajectory(scans.stamps_us, poses) if isinstance(trajectory, gtsam.Values) else trajectory
            problem = _state_as_odometry(radar, track)
        elif isinstance(trajectory, gtsam.Values):
            problem = GivenGraph(graph, trajectory, listed, lift)
        else:
            raise ConfigError("graph: comes without the values that it is optimised at; give gtsam.Values as the trajectory")
        search = find_loops(scans, problem, settings.estimator, radar.beam, runner, recognising=False)
    for warning in search.warnings:
        work.tell(warning)
    return LoopFactors((lift(loop_between(listed[loop.earlier], listed[loop.later], loop)), loop) for loop in search.loops)


def _state_as_odometry(radar: Radar, trajectory: Trajectory) -> Problem:
    """Returns a trajectory as a problem in which its steps err as odometry does."""
    motions = list(measure_motions(ODOMETRY, radar.make_context(trajectory), radar.scans))
    return Problem(motions, [])
