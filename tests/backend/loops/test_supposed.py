"""A lidar's passes are compared where the trajectory places them, even if it is too uncertain for a complete search."""

from __future__ import annotations

import numpy as np
import pytest
from support.corridors import PASS, build_corridor, drive_twice, find_errors, join_passes
from support.passes import let_passes_follow

from mqslam.backend.loops.closing import find_loops
from mqslam.backend.loops.passes import TrackedRun
from mqslam.config import Config
from mqslam.core import se2
from mqslam.execution.runner import Runner
from mqslam.psi.place import beam_of

ESTIMATOR = Config().estimator
BEAM = beam_of(ESTIMATOR, 0.0)
near_passes = let_passes_follow(30.0)  # each pass is 80 m long
HARDLY_KNOWN = 20.0, 20.0, 0.05  # standard deviations of the motion between the passes [m, m, rad]


@pytest.fixture(scope="module")
def drive() -> TrackedRun:
    return drive_twice(build_corridor(0), 1.0)


@pytest.mark.parametrize("off", [(9.0, 4.0, 0.02), (-16.0, 8.0, -0.04)])
def test_passes_are_found_where_the_trajectory_is_too_uncertain(drive: TrackedRun, off: tuple[float, float, float]) -> None:
    problem = join_passes(drive, off, HARDLY_KNOWN)
    search = find_loops(drive.scans, problem, ESTIMATOR, BEAM, Runner())
    assert len(search.loops) >= 5
    for error in find_errors(drive, problem.solve_poses(search.loops), [(k, PASS + k) for k in (20, 40, 60)]):
        assert np.hypot(*error[:2]) < 0.1
        assert abs(error[2]) < 0.003


def test_passes_that_lie_elsewhere_make_no_loop(drive: TrackedRun) -> None:
    """The corridor is passed 60 m away from where the trajectory places the pass: no search reaches the right pose."""
    problem = join_passes(drive, (60.0, 0.0, 0.0), HARDLY_KNOWN)
    for loop in find_loops(drive.scans, problem, ESTIMATOR, BEAM, Runner()).loops:
        truth = se2.between(drive.poses[loop.earlier], drive.poses[loop.later])
        assert np.hypot(*(loop.pose - truth)[:2]) < 0.3
