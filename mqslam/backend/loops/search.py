"""Loop closures of a drive: candidates verified by psi, and by the map that they make."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mqslam.backend.loops.align import Alignment, align, score_at_pose
from mqslam.backend.loops.candidates import Candidate
from mqslam.backend.loops.consistency import LARGEST_CHI_SQUARE, as_relative, compute_chi_square
from mqslam.backend.loops.passes import MATCHED, does_match, is_unrivalled
from mqslam.backend.loops.submap import LATER_SHARE, SUBMAP_M, Passes, render_submap
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.measurement import Loop
from mqslam.execution.progress import Progress
from mqslam.psi.place import Beam, PointSet
from mqslam.psi.score import make_references

# A submap with fewer returns than this is not compared.
_FEWEST = 300
# Largest standard deviation of a loop's position [m].
_SURE_M = 0.3
# A loop stays if psi of its two passes in the optimised map is at most this many times as large as with the passes laid on
# each other.
_KEPT = 1.1


class CandidateScore(NamedTuple):
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
    estimator: EstimatorConfig,
    beam: Beam,
    engine: Engine,
    progress: Progress,
) -> list[CandidateScore]:
    """Lays the two passes of every candidate on each other, each candidate on its own.

    Args:
        drive: scans under the best trajectory so far.
        candidates: pairs of scans that may show one place.
        estimator: settings of the score.
        beam: the sensor's errors.
        engine: where they are compared; the result does not depend on it.
        progress: called as candidates are compared.
    """

    def report(number: int, comparison: CandidateScore) -> None:
        progress("loops", number, len(candidates))

    return engine.map(_compare, (drive, estimator, beam), candidates, report)


def _compare(shared: tuple[Passes, EstimatorConfig, Beam], candidate: Candidate) -> CandidateScore:
    """Returns what psi says about a candidate."""
    drive, estimator, beam = shared
    reach = candidate.reach_m, candidate.reach_rad
    submaps = render_passes((drive, candidate.earlier), (drive, candidate.later), beam)
    alignment = align_passes(*submaps, candidate.chain.motion, reach, estimator)
    if alignment is None:
        return CandidateScore()
    if not is_unrivalled(alignment, MATCHED):
        return CandidateScore(ambiguous=True)
    covariance = candidate.layout.widen(alignment.pose, alignment.covariance)
    loop = Loop(candidate.earlier, candidate.later, alignment.pose, covariance, alignment.matched, alignment.psi)
    if compute_chi_square(candidate.chain, as_relative(loop)) > LARGEST_CHI_SQUARE:
        return CandidateScore(implausible=True)
    return CandidateScore(loop)


def confirm_by_map(
    loops: Sequence[Loop],
    drive: Passes,
    after: se2.Array,
    estimator: EstimatorConfig,
    beam: Beam,
    engine: Engine,
) -> list[Loop]:
    """Returns the loops with which the map of their own two passes is better than without them.

    Args:
        loops: all loops in the graph.
        drive: scans under the trajectory before the loops.
        after: (N, 3) poses with the loops.
        estimator: settings of the score.
        beam: the sensor's errors.
        engine: where they are judged; the result does not depend on it.
    """
    better = engine.map(_improves, (drive, after, estimator, beam), loops)
    return [loop for loop, keep in zip(loops, better, strict=True) if keep]


def _improves(shared: tuple[Passes, se2.Array, EstimatorConfig, Beam], loop: Loop) -> bool:
    """Returns whether psi of the two passes is lower than before, or hardly above both that and the loop's own psi."""
    drive, after, estimator, beam = shared
    reference, query = render_passes((drive, loop.earlier), (drive, loop.later), beam)
    references = make_references(reference)
    before_psi, after_psi = (
        score_at_pose(references, query, se2.between(poses[loop.earlier], poses[loop.later]), estimator)
        for poses in (drive.poses, after)
    )
    return after_psi < before_psi or after_psi <= _KEPT * min(before_psi, loop.psi)


def render_passes(earlier: tuple[Passes, int], later: tuple[Passes, int], beam: Beam) -> tuple[PointSet, PointSet]:
    """Renders the submaps of two passes, of which that of the later one is smaller, so that it lies within the other.

    Args:
        earlier: the scans of the earlier pass, and the number of the one in whose frame its submap is.
        later: the same of the later pass.
        beam: the sensor's errors.
    """
    return render_submap(*earlier, SUBMAP_M, beam), render_submap(*later, LATER_SHARE * SUBMAP_M, beam)


def align_passes(
    earlier: PointSet, later: PointSet, guess: se2.Array, reach: tuple[float, float], estimator: EstimatorConfig
) -> Alignment | None:
    """Lays the submap of a later pass on that of an earlier one by psi.

    Args:
        earlier: submap in its own frame.
        later: submap in its own frame.
        guess: (3,) pose of the later frame in the earlier one [m, m, rad].
        reach: how far the guess may be off in position [m] and in yaw [rad].
        estimator: settings of the score.

    Returns:
        None where a submap holds too few returns, the two do not match, or the pose is too uncertain.
    """
    if len(earlier) < _FEWEST or len(later) < _FEWEST:
        return None
    alignment = align(make_references(earlier), later, guess, reach, estimator)
    sigmas = np.sqrt(np.diag(alignment.covariance))
    if not does_match(alignment, MATCHED) or max(sigmas[0], sigmas[1]) > _SURE_M:
        return None
    return alignment
