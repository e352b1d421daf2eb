"""A lidar's passes are compared where the trajectory places them, even if it is too uncertain for a complete search."""

from __future__ import annotations

import numpy as np
import pytest
from support.corridors import PASS, build_corridor, drive_twice
from support.passes import let_passes_follow

from mqslam.backend.loops.closing import find_loops
from mqslam.backend.problem import Problem
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.measurement import LoopSearch, Measurement
from mqslam.execution.runner import Runner
from mqslam.psi.place import beam_of

ESTIMATOR = Config().estimator
near_passes = let_passes_follow(30.0)  # each pass is 80 m long


def search_after(off: tuple[float, float, float], seed: int = 0) -> tuple[LoopSearch, Problem]:
    """Searches for loops between two passes, the motion between which is off [m, m, rad] and hardly known."""
    drive = drive_twice(build_corridor(seed), 1.0)
    motions = se2.between(drive.poses[:-1], drive.poses[1:])
    motions[PASS - 1] += off
    measurements = []
    for k, motion in enumerate(motions):
        sigmas = (20.0, 20.0, 0.05) if k == PASS - 1 else (0.01, 0.01, 0.001)
        times = float(drive.times[k]), float(drive.times[k + 1])
        measurements.append(Measurement(*times, motion, np.diag(np.square(sigmas))))
    problem = Problem(measurements, [])
    return find_loops(drive.scans, problem, ESTIMATOR, beam_of(ESTIMATOR, 0.0), Runner()), problem


@pytest.mark.parametrize("off", [(9.0, 4.0, 0.02), (-16.0, 8.0, -0.04)])
def test_passes_are_found_where_the_trajectory_is_too_uncertain(off: tuple[float, float, float]) -> None:
    search, problem = search_after(off)
    assert len(search.loops) >= 5
    truth, poses = drive_twice(build_corridor(0), 1.0).poses, problem.solve_poses(search.loops)
    for earlier in (20, 40, 60):
        later = PASS + earlier
        error = se2.between(poses[earlier], poses[later]) - se2.between(truth[earlier], truth[later])
        assert np.hypot(*error[:2]) < 0.1
        assert abs(se2.wrap(error[2])) < 0.003


def test_passes_that_lie_elsewhere_make_no_loop() -> None:
    """The corridor is passed 60 m away from where the trajectory places the pass: no search reaches the right pose."""
    drive, (search, _) = drive_twice(build_corridor(0), 1.0), search_after((60.0, 0.0, 0.0))
    for loop in search.loops:
        truth = se2.between(drive.poses[loop.earlier], drive.poses[loop.later])
        assert np.hypot(*(loop.pose - truth)[:2]) < 0.3
