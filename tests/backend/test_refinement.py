"""After the loops, every scan is laid into the earlier passes around it, and the passes lie better on each other for it."""

from __future__ import annotations

import numpy as np
import pytest
from support.passes import BEAM, LANE_Y, let_passes_follow, noisy_passes, path, street_pass

from mqslam.backend import refinement
from mqslam.backend.loops.passes import TrackedRun
from mqslam.backend.problem import Problem
from mqslam.backend.refinement import drop_replaced, find_crossings, measure_psi_across, refine, select_tied
from mqslam.backend.sensors.odometry import reckon
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.measurement import Loop, Refined
from mqslam.core.scans import Scans
from mqslam.execution.local_engine import HERE, LocalEngine
from mqslam.execution.runner import Runner

APART_M = 35.0  # a pass of the tests is 40 m long
ESTIMATOR = EstimatorConfig()


near_passes = let_passes_follow(APART_M)  # each pass of the tests is 40 m long


def two_passes() -> tuple[TrackedRun, Problem, tuple[Loop, ...]]:
    """Returns two true passes over a street, a problem of noisy motions along them, and a loop that is somewhat off."""
    drive, problem, loop = noisy_passes()
    return drive, problem, (loop,)


def refined(rounds: int = 2, jobs: int = 1) -> Refined:
    drive, problem, loops = two_passes()
    scans = Scans(tuple(drive.scans), 0, 0.25)
    before, runner = reckon(scans, problem.measurements), Runner(LocalEngine(jobs))
    return refine(before, problem, loops, scans, rounds, ESTIMATOR, BEAM, runner)


def apart_m(poses: se2.Array, truth: se2.Array, ties: list[Loop]) -> float:
    """Returns how far [m] the two scans of ties lie off each other, in the root mean square."""
    pairs = np.array([(tie.earlier, tie.later) for tie in ties]).T
    off = se2.between(poses[pairs[0]], poses[pairs[1]]) - se2.between(truth[pairs[0]], truth[pairs[1]])
    return float(np.sqrt(np.mean(off[:, :2] ** 2)))


def test_passes_lie_better_on_each_other_than_loops_have_left_them() -> None:
    drive, problem, loops = two_passes()
    result = refined()
    assert len(result.ties) >= 10 and not result.refused
    before, after = problem.solve_poses(loops), problem.solve_poses(result.loops, result.ties)
    assert apart_m(after, drive.poses, result.ties) < 0.6 * apart_m(before, drive.poses, result.ties)
    assert result.psi_across is not None and result.psi_loops is not None and result.psi_before is not None
    assert result.psi_across < result.psi_loops < result.psi_before


def test_ties_err_as_their_covariance_says() -> None:
    drive, _, _ = two_passes()
    squares = []
    for tie in refined().ties:
        error = se2.wrapped_between(se2.between(drive.poses[tie.earlier], drive.poses[tie.later]), tie.pose)
        squares.append(error @ np.linalg.solve(tie.covariance, error) / 3.0)
    assert 0.1 < np.mean(squares) < 4.0


def test_the_number_of_jobs_changes_no_tie() -> None:
    one, two = refined(), refined(jobs=2)
    assert repr(one) == repr(two)


def test_a_loop_whose_returns_the_ties_use_leaves_the_graph() -> None:
    travelled = np.arange(0.0, 400.0, 2.0)
    loops = [Loop(a, b, np.zeros(3), np.eye(3), 0.7, 0.5) for a, b in ((10, 110), (40, 140), (10, 160))]
    ties = [Loop(12, 113, np.zeros(3), np.eye(3), 0.7, 0.5)]
    assert drop_replaced(loops, ties, travelled) == loops[1:]
    assert refined().loops == []


def test_passes_that_no_loop_ties_are_left_alone() -> None:
    """Two streets side by side look like two passes of one to the trajectory alone."""
    drive, problem, _ = two_passes()
    scans = Scans(tuple(drive.scans), 0, 0.25)
    result = refine(reckon(scans, problem.measurements), problem, [], scans, 2, ESTIMATOR, BEAM, Runner())
    assert result.ties == [] and result.psi_across == result.psi_loops is not None


def test_a_loop_ties_only_passes_near_it() -> None:
    there, back = np.arange(0.0, 300.0, 2.0), np.arange(300.0, 0.0, -2.0)
    drive = path(np.column_stack([np.r_[there, back], np.repeat([0.0, 5.0], len(there))]))
    crossings = find_crossings(drive, 2.0, 60.0)
    loop = Loop(20, 280, np.zeros(3), np.eye(3), 0.7, 0.5)  # at 40 m of 300
    tied = select_tied(crossings, drive, [loop], 60.0)
    assert 0 < len(tied) < len(crossings)
    assert max(drive.poses[crossing.later, 0].max() for crossing in tied) < 40.0 + 60.0 + 25.0


def test_poses_are_kept_where_psi_across_passes_would_rise(monkeypatch: pytest.MonkeyPatch) -> None:
    values = iter([1.0, 3.0, 1.1])
    monkeypatch.setattr(refinement, "measure_psi_across", lambda *_: next(values))
    _, _, loops = two_passes()
    result = refined()
    assert result.refused and result.ties == [] and result.loops == list(loops)
    assert (result.psi_before, result.psi_loops, result.psi_across) == (3.0, 1.0, 1.0)


def test_no_round_leaves_the_loops_as_they_are() -> None:
    result = refined(rounds=0)
    assert result.ties == [] and len(result.loops) == 1 and not result.refused


def test_psi_across_passes_sees_a_torn_map_and_nothing_else() -> None:
    drive, _, _ = two_passes()
    crossings = find_crossings(drive, 5.0, APART_M)
    first = len(street_pass(-25.0, LANE_Y, 0.0, 1).times)
    torn = drive.poses + np.where(np.arange(len(drive.poses)) >= first, 0.5, 0.0)[:, None] * np.array([0.0, 1.0, 0.0])
    moved = se2.compose(np.array([100.0, 50.0, 1.0]), drive.poses)

    def psi(poses: se2.Array) -> float:
        value = measure_psi_across(TrackedRun.of(drive.scans, poses), crossings, ESTIMATOR, BEAM, HERE)
        assert value is not None
        return value

    assert psi(torn) > 1.5 * psi(drive.poses)
    assert psi(moved) == pytest.approx(psi(drive.poses), rel=0.02)


def test_where_no_place_is_passed_twice_there_is_no_psi_across_passes() -> None:
    drive = street_pass(-25.0, LANE_Y, 0.0, 1)
    crossings = find_crossings(drive, 5.0, APART_M)
    assert crossings == []
    assert measure_psi_across(drive, crossings, ESTIMATOR, BEAM, HERE) is None


def test_a_parked_radar_is_no_second_pass() -> None:
    assert find_crossings(path(np.zeros((50, 2))), 5.0, APART_M) == []
