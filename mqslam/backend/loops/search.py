"""Loop closures of a drive: candidates from its own uncertainty, verified by psi."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mqslam.backend.loops.align import align, score_at_pose
from mqslam.backend.loops.passes import compute_reach, find_pass_pairs, is_unrivalled
from mqslam.backend.loops.submap import Drive, render_submap
from mqslam.config import EstimatorConfig, LoopConfig
from mqslam.core import se2
from mqslam.core.measurement import Loop
from mqslam.execution.engine import Engine
from mqslam.execution.progress import Progress
from mqslam.psi.place import Beam, PointSet


def find_loops(
    drive: Drive,
    settings: LoopConfig,
    estimator: EstimatorConfig,
    beam: Beam,
    tried: set[tuple[int, int]],
    engine: Engine,
    progress: Progress,
) -> list[Loop]:
    """Finds the loops of a drive, each verified by psi on its own.

    Args:
        drive: scans under the best trajectory so far.
        settings: of loops.
        estimator: settings of the score.
        beam: the sensor's errors.
        tried: pairs that are not tried again; those of this search are added.
        engine: where they are verified; the result does not depend on it.
        progress: called as candidates are verified.
    """
    pairs = find_candidate_pairs(drive, settings, tried)
    tried.update(pairs)

    def report(number: int, loop: Loop | None) -> None:
        progress("loops", number, len(pairs))

    loops = engine.map(_verify, (drive, settings, estimator, beam), pairs, report)
    return [loop for loop in loops if loop is not None]


def find_candidate_pairs(drive: Drive, settings: LoopConfig, tried: set[tuple[int, int]]) -> list[tuple[int, int]]:
    """Finds pairs (earlier, later) of scans that may show one place, as `find_pass_pairs` does."""
    return find_pass_pairs(drive.travelled, drive.poses, settings, settings.passes, tried)


def _verify(shared: tuple[Drive, LoopConfig, EstimatorConfig, Beam], pair: tuple[int, int]) -> Loop | None:
    """Returns the loop of a pair of scans, or None where psi does not confirm it."""
    drive, settings, estimator, beam = shared
    earlier, later = pair
    reference, query = _render_submaps(drive, earlier, later, settings, beam)
    if len(reference) < settings.fewest or len(query) < settings.fewest:
        return None
    guess = se2.between(drive.poses[earlier], drive.poses[later])
    reach = compute_reach(float(drive.travelled[later] - drive.travelled[earlier]), settings)
    alignment = align(reference, query, guess, reach, settings, estimator)
    sigmas = np.sqrt(np.diag(alignment.covariance))
    if not is_unrivalled(alignment, settings) or max(sigmas[0], sigmas[1]) > settings.sure_m:
        return None
    return Loop(earlier, later, alignment.pose, alignment.covariance, alignment.matched, alignment.psi)


def confirm_by_map(
    loops: Sequence[Loop],
    drive: Drive,
    after: se2.Array,
    settings: LoopConfig,
    estimator: EstimatorConfig,
    beam: Beam,
    engine: Engine,
) -> list[Loop]:
    """Returns the loops with which the map of their own two passes is better than without them.

    Args:
        loops: all loops in the graph.
        drive: scans under the trajectory before the loops.
        after: (N, 3) poses with the loops.
        settings: of loops.
        estimator: settings of the score.
        beam: the sensor's errors.
        engine: where they are judged; the result does not depend on it.
    """
    better = engine.map(_improves, (drive, after, settings, estimator, beam), loops)
    return [loop for loop, keep in zip(loops, better, strict=True) if keep]


def _improves(shared: tuple[Drive, se2.Array, LoopConfig, EstimatorConfig, Beam], loop: Loop) -> bool:
    """Returns whether psi of the two passes is lower than before, or hardly above both that and the loop's own psi."""
    drive, after, settings, estimator, beam = shared
    reference, query = _render_submaps(drive, loop.earlier, loop.later, settings, beam)
    before_psi, after_psi = (
        score_at_pose(reference, query, se2.between(poses[loop.earlier], poses[loop.later]), estimator)
        for poses in (drive.poses, after)
    )
    return after_psi < before_psi or after_psi <= settings.kept * min(before_psi, loop.psi)


def _render_submaps(drive: Drive, earlier: int, later: int, settings: LoopConfig, beam: Beam) -> tuple[PointSet, PointSet]:
    """Renders the earlier pass, and the smaller part of the later one that is laid into it."""
    reach_m, spacing_m = settings.submap_m, settings.spacing_m
    return (
        render_submap(drive, earlier, reach_m, spacing_m, beam),
        render_submap(drive, later, settings.later_share * reach_m, spacing_m, beam),
    )
