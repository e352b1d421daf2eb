"""Loop closure in rounds: every round searches around the trajectory that the loops found before have corrected."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from mqslam.backend.loops.candidates import Chain, find_candidates
from mqslam.backend.loops.consistency import keep_consistent
from mqslam.backend.loops.search import compare_passes, confirm_by_map
from mqslam.backend.loops.submap import Drive, Passes
from mqslam.backend.problem import GraphProblem
from mqslam.config import EstimatorConfig
from mqslam.core.measurement import Loop, LoopSearch
from mqslam.core.scans import Scans
from mqslam.execution.runner import Runner
from mqslam.psi.place import Beam

_log = logging.getLogger(__name__)


def close_loops(scans: Scans, problem: GraphProblem, estimator: EstimatorConfig, beam: Beam, runner: Runner) -> LoopSearch:
    """Returns the loops that psi verifies, that the trajectory allows, that agree and that make the map better.

    Args:
        scans: scans of the recording.
        problem: the trajectory that the loops join.
        estimator: settings of the estimator.
        beam: the sensor model.
        runner: does the work.

    Raises:
        EstimationError: the uncertainty of the trajectory cannot be computed.
    """
    settings = problem.loop_settings
    loops: list[Loop] = []
    compared: set[tuple[int, int]] = set()
    decided: set[tuple[int, int]] = set()
    ambiguous = 0
    before: Passes | None = None
    for _ in range(settings.rounds):
        chain = _optimise(scans, problem, loops)
        before = chain.drive if before is None else before
        candidates, unsure = find_candidates(chain, settings, decided)
        comparisons = compare_passes(chain.drive, candidates, settings, estimator, beam, runner.engine, runner.progress)
        implausible = {c[:2] for c, comparison in zip(candidates, comparisons, strict=True) if comparison.implausible}
        compared |= {c[:2] for c in candidates}
        decided |= {c[:2] for c in candidates} - implausible  # a trajectory that loops have corrected may allow these
        ambiguous += sum(comparison.ambiguous for comparison in comparisons)
        new = [comparison.loop for comparison in comparisons if comparison.loop is not None]
        if not new:
            break
        loops = loops + keep_consistent(new, chain, settings)
        del chain  # what it has eliminated takes more memory than anything else here
        loops = confirm_by_map(loops, before, problem.solve_poses(loops), settings, estimator, beam, runner.engine)
    _log.info("%d of %d pairs of passes are loops that the map keeps", len(loops), len(compared))
    _log.info("%d pairs match at several places, %d at an implausible one", ambiguous, len(implausible))
    return LoopSearch(loops, len(compared), ambiguous, len(implausible), len(unsure))


def _optimise(scans: Scans, problem: GraphProblem, loops: Sequence[Loop]) -> Chain:
    """Returns the optimised trajectory with some loops."""
    graph, optimum = problem.optimise(loops)
    return Chain(Drive.of(scans, graph.poses_at(optimum.values)), graph, optimum.values)
