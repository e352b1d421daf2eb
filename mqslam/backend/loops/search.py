"""Loop closures of a drive: candidates verified by psi, and by the map that they make."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mqslam.backend.loops.align import align, score_at_pose
from mqslam.backend.loops.candidates import Candidate
from mqslam.backend.loops.consistency import as_relative, compute_chi_square, compute_limit
from mqslam.backend.loops.layout import LATER_SHARE
from mqslam.backend.loops.passes import does_match, is_unrivalled
from mqslam.backend.loops.submap import Passes, render_submap
from mqslam.config import EstimatorConfig, LoopConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.measurement import Loop
from mqslam.execution.progress import Progress
from mqslam.psi.place import Beam, PointSet
from mqslam.psi.scoring.references import make_references


class Comparison(NamedTuple):
    """What psi says about a candidate.

    Args:
        loop: the loop, or None where psi does not confirm it.
        ambiguous: whether the passes match, but fit several places that the trajectory allows.
        implausible: whether the passes match at one place only, which the trajectory rules out.
    """

    loop: Loop | None = None
    ambiguous: bool = False
    implausible: bool = False


def compare_passes(
    drive: Passes,
    candidates: Sequence[Candidate],
    settings: LoopConfig,
    estimator: EstimatorConfig,
    beam: Beam,
    engine: Engine,
    progress: Progress,
) -> list[Comparison]:
    """Lays the two passes of every candidate on each other, each candidate on its own.

    Args:
        drive: scans under the best trajectory so far.
        candidates: pairs of scans that may show one place.
        settings: of loops.
        estimator: settings of the score.
        beam: the sensor's errors.
        engine: where they are compared; the result does not depend on it.
        progress: called as candidates are compared.
    """

    def report(number: int, comparison: Comparison) -> None:
        progress("loops", number, len(candidates))

    return engine.map(_compare, (drive, settings, estimator, beam), candidates, report)


def _compare(shared: tuple[Passes, LoopConfig, EstimatorConfig, Beam], candidate: Candidate) -> Comparison:
    """Returns what psi says about a candidate."""
    drive, settings, estimator, beam = shared
    reference, query = _render_submaps(drive, candidate.earlier, candidate.later, settings, beam)
    if len(reference) < settings.fewest or len(query) < settings.fewest:
        return Comparison()
    reach = candidate.reach_m, candidate.reach_rad
    alignment = align(make_references(reference), query, candidate.chain.motion, reach, settings, estimator)
    sigmas = np.sqrt(np.diag(alignment.covariance))
    if not does_match(alignment, settings) or max(sigmas[0], sigmas[1]) > settings.sure_m:
        return Comparison()
    if not is_unrivalled(alignment, settings):
        return Comparison(ambiguous=True)
    covariance = candidate.layout.widen(alignment.pose, alignment.covariance)
    loop = Loop(candidate.earlier, candidate.later, alignment.pose, covariance, alignment.matched, alignment.psi)
    if compute_chi_square(candidate.chain, as_relative(loop, settings)) > compute_limit(settings):
        return Comparison(implausible=True)
    return Comparison(loop)


def confirm_by_map(
    loops: Sequence[Loop],
    drive: Passes,
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


def _improves(shared: tuple[Passes, se2.Array, LoopConfig, EstimatorConfig, Beam], loop: Loop) -> bool:
    """Returns whether psi of the two passes is lower than before, or hardly above both that and the loop's own psi."""
    drive, after, settings, estimator, beam = shared
    reference, query = _render_submaps(drive, loop.earlier, loop.later, settings, beam)
    references = make_references(reference)
    before_psi, after_psi = (
        score_at_pose(references, query, se2.between(poses[loop.earlier], poses[loop.later]), estimator)
        for poses in (drive.poses, after)
    )
    return after_psi < before_psi or after_psi <= settings.kept * min(before_psi, loop.psi)


def _render_submaps(drive: Passes, earlier: int, later: int, settings: LoopConfig, beam: Beam) -> tuple[PointSet, PointSet]:
    """Renders the earlier pass, and the smaller part of the later one that is laid into it."""
    reach_m, spacing_m = settings.submap_m, settings.spacing_m
    return (
        render_submap(drive, earlier, reach_m, spacing_m, beam),
        render_submap(drive, later, LATER_SHARE * reach_m, spacing_m, beam),
    )
