"""Loop closure in rounds: every round searches around the trajectory that the loops found before have corrected."""

from __future__ import annotations

import logging

from mqslam.backend.loops.search import confirm_by_map, find_loops
from mqslam.backend.loops.submap import Drive
from mqslam.backend.problem import Problem
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.measurement import Loop, LoopSearch
from mqslam.core.scans import Scans
from mqslam.execution.runner import Runner
from mqslam.psi.place import Beam

_log = logging.getLogger(__name__)


def close_loops(
    scans: Scans,
    problem: Problem,
    poses: se2.Array,
    estimator: EstimatorConfig,
    beam: Beam,
    runner: Runner,
) -> LoopSearch:
    """Returns the loops that psi verifies and that make the map better.

    Args:
        scans: scans of the recording.
        problem: the trajectory that the loops join.
        poses: (N, 3) the optimum of the trajectory without loops [m, m, rad].
        estimator: settings of the estimator.
        beam: the sensor model.
        runner: does the work.
    """
    settings = problem.loop_settings
    loops: list[Loop] = []
    tried: set[tuple[int, int]] = set()
    drive = Drive.of(scans, poses)
    before = drive
    for _ in range(settings.rounds):
        candidates = find_loops(drive, settings, estimator, beam, tried, runner.engine, runner.progress)
        if not candidates:
            break
        after = problem.solve_poses(loops + candidates)
        loops = confirm_by_map(loops + candidates, before, after, settings, estimator, beam, runner.engine)
        drive = Drive.of(scans, problem.solve_poses(loops))
    _log.info("%d of %d pairs of passes are loops that the map keeps", len(loops), len(tried))
    return LoopSearch(loops, len(tried))
