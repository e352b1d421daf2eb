"""The refinement: once the loops are closed, psi registers every scan of a later pass on the earlier passes.

A loop registers one short submap on another one. Errors of the motions between the scans of a submap bend the submap. Here
every scan is rendered by itself, at its pose with the loops, and registered among the returns of all earlier passes, which
do not move. The result becomes a tie: a factor between the scan and the nearest scan of the earlier passes. The graph is
solved again, and the scans are registered once more at their new poses.

Only passes that a loop connects are registered: the refinement makes loops more accurate and does not find new ones. A tie
replaces the loops near it, since both are measured from the same returns.

psi of a whole map depends mostly on returns that follow each other within seconds, and hardly shows whether two passes of a
place lie on each other. psi across passes shows this: a later pass is scored only against the points of earlier passes.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.backend.loops import passes
from mqslam.backend.loops.passes import SUBMAP_M, TrackedRun
from mqslam.backend.loops.registration import observes_all, score_among
from mqslam.backend.loops.rigid import minimise_rigidly, move_rigidly
from mqslam.backend.problem import GraphProblem
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.measurement import Loop, Refined
from mqslam.core.scans import Returns, Scans
from mqslam.core.trajectory import Trajectory
from mqslam.execution.runner import Runner
from mqslam.mapping.keyframing import pick_spaced
from mqslam.mapping.render import place_along
from mqslam.psi.covariance import estimate_covariance
from mqslam.psi.place import Beam, PointSet
from mqslam.psi.score import References, make_references

SAMPLE_M = 20.0
"""Path [m] between the scans at which psi across passes is measured for the summary."""
# Largest distance [m] between scans of two passes that are compared.
_REACH_M = 25.0
# Path [m] between those scans of the earlier passes on which later scans are registered.
_SPACING_M = 2.0


@dataclass(frozen=True, slots=True)
class Crossing:
    """A place that was passed several times, with successive scans of one pass and nearby scans of earlier passes.

    Args:
        later: (K,) numbers of the scans of the later pass.
        earlier: (M,) numbers of the scans of the earlier passes.
    """

    later: NDArray[np.int64]
    earlier: NDArray[np.int64]


def find_crossings(drive: TrackedRun, spacing_m: float, least_path_m: float) -> list[Crossing]:
    """Finds the stretches of a drive's path that lie near earlier parts of the path.

    Later passes are compared with earlier ones only, so that no two returns are compared twice.

    Args:
        drive: scans under a trajectory.
        spacing_m: path between the scans of the later pass [m].
        least_path_m: two scans belong to different passes if the path [m] between them is longer than this.
    """
    later, earlier = pick_spaced(drive.travelled, spacing_m), pick_spaced(drive.travelled, _SPACING_M)
    xy = drive.poses[:, :2]
    tree = cKDTree(xy[earlier])
    stretches = np.floor(drive.travelled[later] / _REACH_M)
    crossings = []
    for scans in np.split(later, np.flatnonzero(np.diff(stretches)) + 1):
        around = set().union(*tree.query_ball_point(xy[scans], _REACH_M))
        others = earlier[sorted(around)]
        others = others[drive.travelled[others] < drive.travelled[scans[0]] - least_path_m]
        if len(others):
            apart, _ = cKDTree(xy[others]).query(xy[scans])
            crossings.append(Crossing(scans[apart <= _REACH_M], others))
    return [crossing for crossing in crossings if len(crossing.later)]


def measure_psi_across(
    drive: TrackedRun, crossings: Sequence[Crossing], estimator: EstimatorConfig, beam: Beam, engine: Engine
) -> float | None:
    """Returns psi per point of the later passes' returns among the earlier passes' returns; None without such returns.

    Args:
        drive: scans under the trajectory that is measured.
        crossings: places where psi is measured. They may be found under another trajectory, so that two trajectories are
            compared at the same places.
        estimator: settings of the score.
        beam: the sensor's measurement errors.
        engine: engine that scores the points; the result does not depend on it.
    """
    parts = engine.map(_score_crossing, (drive, estimator, beam), crossings)
    points = sum(number for _, number in parts)
    return sum(psi for psi, _ in parts) / points if points else None


def render_scans(drive: TrackedRun, scans: Sequence[int] | NDArray[np.int64], beam: Beam) -> PointSet:
    """Renders the returns of the scans with the given numbers as points in the frame of the drive's trajectory."""
    returns = Returns.concatenate([drive.scans[k].returns for k in scans])
    return place_along(returns, drive.times, drive.poses, beam)


def _score_crossing(shared: tuple[TrackedRun, EstimatorConfig, Beam], crossing: Crossing) -> tuple[float, int]:
    """Returns the total psi of a crossing's later returns among its earlier returns, and the number of the later returns.

    `shared` holds the scans under a trajectory, the settings of the score, and the sensor's measurement errors.
    """
    drive, estimator, beam = shared
    earlier = make_references(render_scans(drive, crossing.earlier, beam))
    later = render_scans(drive, crossing.later, beam)
    return score_among(earlier, later, estimator).psi, len(later)


EVERY_SCAN_M: Final = 1e-3
"""Path [m] between the scans that are registered. It is so short that only scans of a standing radar are left out."""
# A scan that psi moves farther than this [m] away from its pose with the loops is not used.
_ASIDE_M = 0.5
# The rounds end once no scan moves relative to the earlier pass by more than this many standard deviations.
_SETTLED = 0.1
_FIRST_STEP: Final = 2  # annealing step to begin with: with the loops, passes lie nearer than the widths of earlier steps
_SHARED: Final = 2.0  # factor on a scan's covariance, since the returns of the earlier pass have errors of the same size

_log = logging.getLogger(__name__)

# scans under the trajectory so far; covariance (N, 3, 3) of each scan's own pose error, without drift, in the scan's frame
# [m, m, rad]; settings of the score; the sensor's errors
_Setting = tuple[TrackedRun, NDArray[np.float64], EstimatorConfig, Beam]


def refine(
    before: Trajectory,
    problem: GraphProblem,
    loops: Sequence[Loop],
    scans: Scans,
    rounds: int,
    estimator: EstimatorConfig,
    beam: Beam,
    runner: Runner,
) -> Refined:
    """Refines a trajectory by registering later passes on earlier ones, in rounds.

    The rounds end when psi across passes would increase (the last round is then dropped), when the scans hardly move any
    more, when no scan can be registered, or when the largest number of rounds is reached.

    Args:
        before: the trajectory before optimisation, whose psi across passes is measured for comparison.
        problem: the trajectory to refine, which can be optimised.
        loops: loops in the graph of the problem.
        scans: scans of the recording.
        rounds: largest number of rounds, each of which registers the scans of later passes that loops connect with earlier
            passes; with zero rounds or without loops, only psi across passes is measured.
        estimator: settings of the score.
        beam: the sensor's measurement errors.
        runner: does the work.

    Returns:
        The loops and ties of the refined trajectory, and psi across passes before and after.

    Raises:
        EstimationError: the graph cannot be optimised, or does not determine the covariances.
    """
    apart_m, engine = passes.LEAST_PATH_M, runner.engine
    drive = TrackedRun.of(scans, problem.solve_poses(loops))
    places = find_crossings(drive, SAMPLE_M, apart_m)

    def psi_under(poses: se2.Array) -> float | None:
        return measure_psi_across(replace(drive, poses=poses), places, estimator, beam, engine)

    closed = psi_under(drive.poses)
    best = Refined(list(loops), [], psi_under(before.poses), closed, closed)
    rounds = rounds if loops else 0
    variances = problem.estimate_own_covariances() if rounds else np.empty((0, 3, 3))
    for number in range(rounds):
        crossings = select_tied(find_crossings(drive, EVERY_SCAN_M, apart_m), drive, loops, apart_m)
        measured = engine.map(measure_crossing, (drive, variances, estimator, beam), crossings)
        ties = list(chain.from_iterable(runner.follow("refine", measured, len(crossings))))
        if not ties:
            break
        left = drop_replaced(loops, ties, drive.travelled)
        poses = problem.solve_poses(left, ties)
        psi = psi_under(poses)
        _log.info("round %d registers %d scans on earlier passes: psi across passes %s", number + 1, len(ties), psi)
        if psi is None or best.psi_across is None or psi > best.psi_across:
            best = replace(best, refused=number == 0)
            break
        best = replace(best, loops=left, ties=ties, psi_across=psi)
        settled = _is_settled(ties, drive.poses, poses)
        drive = TrackedRun.of(scans, poses)
        if settled:
            break
    return best


def select_tied(crossings: Sequence[Crossing], drive: TrackedRun, loops: Sequence[Loop], reach_m: float) -> list[Crossing]:
    """Returns the crossings whose passes a loop connects; earlier scans that no loop connects to the later pass are removed.

    Args:
        crossings: places that were passed several times.
        drive: scans under a trajectory.
        loops: loops in the graph of the trajectory.
        reach_m: a loop connects two scans if each lies within this path [m] from a scan of the loop.
    """
    tied = cKDTree([(drive.travelled[loop.earlier], drive.travelled[loop.later]) for loop in loops])
    selected = []
    for crossing in crossings:
        middle = float(drive.travelled[crossing.later].mean())
        pairs = np.column_stack([drive.travelled[crossing.earlier], np.full(len(crossing.earlier), middle)])
        away, _ = tied.query(pairs, p=np.inf)
        if np.any(away <= reach_m):
            selected.append(replace(crossing, earlier=crossing.earlier[away <= reach_m]))
    return selected


def drop_replaced(loops: Sequence[Loop], ties: Sequence[Loop], travelled: NDArray[np.float64]) -> list[Loop]:
    """Returns the loops that no tie replaces. A tie replaces a loop if both were measured from the same returns.

    This is the case if the path from the loop's scans to the tie's scans is at most SUBMAP_M, along both passes.

    Args:
        loops: loops in the graph of the trajectory.
        ties: ties of the refinement.
        travelled: (N,) length of the path up to each scan [m].
    """
    ends = cKDTree([(travelled[tie.earlier], travelled[tie.later]) for tie in ties])
    away, _ = ends.query(np.array([(travelled[a.earlier], travelled[a.later]) for a in loops]), p=np.inf)
    return [loop for loop, near in zip(loops, away <= SUBMAP_M, strict=True) if not near]


def measure_crossing(shared: _Setting, crossing: Crossing) -> list[Loop]:
    """Registers the scans of a crossing's later pass on the earlier passes; returns a tie for each scan that fits well.

    `shared` holds the trajectory and the settings, as the comment on `_Setting` lists them.
    """
    drive, _, _, beam = shared
    references = make_references(render_scans(drive, crossing.earlier, beam))
    tree = cKDTree(drive.poses[crossing.earlier, :2])
    ties = []
    for later in crossing.later:
        _, nearest = tree.query(drive.poses[later, :2])
        tie = _measure_scan(shared, references, int(crossing.earlier[nearest]), int(later))
        if tie is not None:
            ties.append(tie)
    return ties


def _measure_scan(shared: _Setting, references: References, anchor: int, later: int) -> Loop | None:
    """Registers the scan `later` among the references; returns its tie to the scan `anchor`, or None if it fits badly.

    The references are returns of earlier passes, one of whose scans is `anchor`. `shared` is as in `measure_crossing`.
    """
    drive, own, estimator, beam = shared
    guess = drive.poses[later]
    scan = move_rigidly(render_scans(drive, [later], beam), se2.inverse(guess))
    if len(scan) == 0:
        return None

    minimum = minimise_rigidly(guess, scan, references, estimator, _FIRST_STEP)
    moved, matched = se2.between(guess, minimum.state), minimum.evaluation.overlap
    is_near = np.hypot(moved[0], moved[1]) <= _ASIDE_M
    if not (minimum.converged and is_near and matched >= passes.MATCHED):
        return None
    points = move_rigidly(scan, minimum.state)
    if not observes_all(references, points, estimator):
        return None
    covariance = _SHARED * estimate_covariance(minimum.evaluation, points.points, estimator.cluster_m)
    in_anchor = se2.rotate_covariance(covariance, -drive.poses[anchor, 2])
    pose = se2.between(drive.poses[anchor], minimum.state)
    # The scan was registered on many scans of earlier passes, but the tie names only `anchor`, whose own error is added.
    lever = se2.adjoint([-pose[0], -pose[1], 0.0])
    return Loop(
        anchor,
        later,
        pose,
        in_anchor + lever @ own[anchor] @ lever.T,
        matched,
        minimum.evaluation.psi / len(scan),
    )


def _is_settled(ties: Sequence[Loop], before: se2.Array, after: se2.Array) -> bool:
    """Returns whether every tie's later scan moved relative to its earlier scan by less than _SETTLED standard deviations.

    `before` and `after` are the poses (N, 3) of all scans before and after a round [m, m, rad].
    """
    earlier, later = np.array([(tie.earlier, tie.later) for tie in ties]).T
    moved = se2.subtract(se2.between(after[earlier], after[later]), se2.between(before[earlier], before[later]))
    sigmas = np.sqrt([np.diag(tie.covariance) for tie in ties])
    return bool(np.all(np.abs(moved) < _SETTLED * sigmas))
