"""Links between recordings: found around the poses that the links before have corrected, and confirmed by the map."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.loops import passes
from mqslam.backend.loops.align import score_at_pose
from mqslam.backend.loops.candidates import find_candidates
from mqslam.backend.loops.chain import Chain
from mqslam.backend.loops.consistency import keep_consistent
from mqslam.backend.loops.search import compare_passes, confirm_by_map, render_passes
from mqslam.backend.loops.submap import MappedDrive, Passes
from mqslam.backend.problem import GraphProblem
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.keyframes import Keyframes
from mqslam.core.measurement import Loop
from mqslam.execution.runner import Runner
from mqslam.psi.place import Beam
from mqslam.psi.scoring.references import make_references

# Number of searches for further links; each starts from the poses that the links found before have corrected.
_ROUNDS = 2

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Links:
    """Links between the keyframes of different parts.

    Args:
        links: those that the map keeps; the earlier end is the keyframe with the lower number.
        compared: number of pairs of keyframes that were compared, besides those that recognition has matched.
        ambiguous: number of these that match at several places.
        implausible: number of these that match at a place that the joint trajectory rules out.
    """

    links: list[Loop]
    compared: int
    ambiguous: int
    implausible: int


def find_links(
    keyframes: Keyframes,
    problem: GraphProblem,
    start: se2.Array,
    first: Sequence[Loop],
    groups: NDArray[np.int64],
    estimator: EstimatorConfig,
    beam: Beam,
    runner: Runner,
) -> Links:
    """Finds the links between the keyframes of different parts, beginning with those that recognition has found.

    Args:
        keyframes: of all parts.
        problem: the joint graph.
        start: (K, 3) poses of the keyframes before any link joins the graph.
        first: links that recognition has found, which agree.
        groups: (K,) part of each keyframe.
        estimator: settings of the score.
        beam: the sensor's errors.
        runner: does the work.

    Raises:
        EstimationError: the joint graph cannot be optimised, or its uncertainty cannot be computed.
    """
    engine = runner.engine
    before = MappedDrive.of(keyframes, start)
    links = confirm_by_map(first, before, problem.solve_poses(first), estimator, beam, engine)
    decided = {(link.earlier, link.later) for link in first}
    compared, ambiguous, implausible = set[tuple[int, int]](), 0, set[tuple[int, int]]()
    for _ in range(_ROUNDS if links else 0):
        graph, optimum = problem.optimise(links)
        chain = Chain(MappedDrive.of(keyframes, graph.poses_at(optimum.values)), graph, optimum.values)
        candidates, _ = find_candidates(chain, decided, groups)
        comparisons = compare_passes(chain.drive, candidates, estimator, beam, engine, runner.progress)
        implausible = {c[:2] for c, comparison in zip(candidates, comparisons, strict=True) if comparison.implausible}
        compared |= {c[:2] for c in candidates}
        decided |= {c[:2] for c in candidates} - implausible
        ambiguous += sum(comparison.ambiguous for comparison in comparisons)
        new = [comparison.loop for comparison in comparisons if comparison.loop is not None]
        if not new:
            break
        links = links + keep_consistent(new, chain, passes.LEAST_PATH_M)
        del chain  # what it has eliminated takes more memory than anything else here
        links = confirm_by_map(links, before, problem.solve_poses(links), estimator, beam, engine)
    _log.info("%d links: %d pairs compared besides %d that were recognised", len(links), len(compared), len(first))
    return Links(links, len(compared), ambiguous, len(implausible))


def score_links(
    keyframes: Keyframes,
    links: Sequence[Loop],
    poses: Sequence[se2.Array],
    estimator: EstimatorConfig,
    beam: Beam,
    engine: Engine,
) -> NDArray[np.float64]:
    """Scores the two passes of each link on each other.

    Args:
        keyframes: of all parts.
        links: the links.
        poses: (K, 3) of the keyframes, several times.
        estimator: settings of the score.
        beam: the sensor's errors.
        engine: where they are scored.

    Returns:
        psi per point (L, T) of each link at each of the T sets of poses.
    """
    drives: list[Passes] = [MappedDrive.of(keyframes, some) for some in poses]
    scores = engine.map(_score, (drives, estimator, beam), list(links))
    return np.array(scores).reshape(len(links), len(drives))


def _score(shared: tuple[list[Passes], EstimatorConfig, Beam], link: Loop) -> list[float]:
    drives, estimator, beam = shared
    last = drives[-1]  # submaps are rendered once, so that only the pose between them differs
    reference, query = render_passes((last, link.earlier), (last, link.later), beam)
    references = make_references(reference)
    return [
        score_at_pose(references, query, se2.between(drive.poses[link.earlier], drive.poses[link.later]), estimator)
        for drive in drives
    ]
