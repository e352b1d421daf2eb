"""The refinement of a GTSAM graph of one's own by psi."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import gtsam
from gtsam.symbol_shorthand import X

from mqslam.backend import refinement
from mqslam.backend.problem import GivenGraph
from mqslam.commands.graphs.keys import Keys, choose_lift, find_pose_kind, list_keys, read_poses
from mqslam.commands.graphs.radar import Source, look_at
from mqslam.commands.work import QUIET, Work
from mqslam.config import Config
from mqslam.core.measurement import Loop
from mqslam.core.trajectory import Trajectory

LoopFactor = tuple[gtsam.NonlinearFactor, Loop]


@dataclass(frozen=True)
class RefinedGraph:
    """A graph whose passes are tied scan by scan, and its optimum.

    Args:
        graph: the given factors, those of the loops that stay, and those of the ties.
        values: the optimum of this graph.
        loops: the loops that stay, since no tie measures their returns, each with its factor.
        ties: poses of single scans among the earlier passes around them, in the frame of the nearest scan of these, each
            with its factor.
        psi_before: psi per point of the later passes' returns among those of the earlier ones, at the given values; None
            where no place is passed twice.
        psi_loops: the same at the optimum with all loops, before any scan was measured.
        psi_after: the same at the optimum of this graph.
    """

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    loops: Sequence[LoopFactor]
    ties: Sequence[LoopFactor]
    psi_before: float | None
    psi_loops: float | None
    psi_after: float | None


def refine(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    recording: Source,
    keys: Keys = X,
    *,
    loops: Sequence[LoopFactor],
    rounds: int = 2,
    config: Config | Path | str | None = None,
    work: Work = QUIET,
) -> RefinedGraph:
    """Measures every scan anew by psi among the earlier passes around it, where a graph of one's own has them.

    The factors of these measurements, *ties*, stand in the place of the loops between the same passes, which lay one rigid
    submap on another; a return counts once. Only passes that a loop ties are looked at. The graph is optimised again, and
    the scans are measured once more where they have come to lie. The ties stay only if psi across passes becomes no larger:
    otherwise the graph comes back with its loops.

    Args:
        graph: all factors but those of loops; they determine every variable. It is not changed.
        values: of all variables, with a pose (`gtsam.Pose2` or `gtsam.Pose3`) for the start of every scan. The optimisation
            starts from them. They are not changed.
        recording: a recording's path, the open recording, or its scans, such as those of `psi_factors`.
        keys: GTSAM's key of the pose of each scan by its number (0, 1, ...): a function, or a sequence with a key for
            each; by default `gtsam.symbol("x", k)`.
        loops: the loops and their factors, as `loop_factors` returns them.
        rounds: most rounds in which every scan is measured; it takes the place of `refinement.rounds` of the settings, with
            which a run leaves the refinement out by default.
        config: settings, or the path of a YAML file, or the name of one that ships with mqslam; None takes the defaults.
        work: where the work is done, and who is told about it.

    Raises:
        ConfigError: a key, a value or a setting is wrong.
        DataError: the recording cannot be used.
        EstimationError: the graph cannot be optimised, or does not determine its poses.

    Example:
        >>> refined = mqslam.refine(graph, values, "drive", keys, loops=loops)  # doctest: +SKIP
        >>> print(refined.psi_loops, refined.psi_after, len(refined.ties))  # doctest: +SKIP
    """
    with look_at(recording, config, work) as radar:
        scans, settings = radar.scans, radar.config
        listed = list_keys(keys, len(scans))
        before = Trajectory(scans.stamps_us, read_poses(values, listed))
        lift = choose_lift(find_pose_kind(values, listed[0]))
        problem = GivenGraph(graph, values, listed, lift)
        found = [loop for _, loop in loops]
        refined = refinement.refine(before, problem, found, scans, rounds, settings.estimator, radar.beam, radar.runner)
    whole, optimum = problem.optimise(refined.loops, refined.ties)
    return RefinedGraph(
        graph=whole.factors,
        values=optimum.values,
        loops=list(zip(problem.make_loop_factors(refined.loops), refined.loops, strict=True)),
        ties=list(zip(problem.make_tie_factors(refined.ties), refined.ties, strict=True)),
        psi_before=refined.psi_before,
        psi_loops=refined.psi_loops,
        psi_after=refined.psi_across,
    )
