"""What closing loops leads to on a whole drive, and what is said about passes that could not be tied."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from support.chains import fenced_street
from support.passes import BEAM, CONFIG, joined, let_passes_follow

from mqslam.backend.loops import closing
from mqslam.backend.loops.closing import find_loops
from mqslam.backend.loops.passes import TrackedRun
from mqslam.backend.loops.recognition import Recognition
from mqslam.backend.problem import Problem
from mqslam.core import se2
from mqslam.core.measurement import Loop, LoopSearch, Measurement
from mqslam.core.scans import Scans
from mqslam.execution.runner import Runner

OFF_M = 6.0


near_passes = let_passes_follow(50.0)  # each pass of the tests is 58 m long


def drifted(period_m: float, between_passes_m: float) -> tuple[Scans, Problem]:
    """Returns two passes over a street; the motion between the passes is 6 m wrong, and as sure as asked."""
    first, second = fenced_street(period_m, 1), fenced_street(period_m, 2)
    drive = joined(first, second, second.poses + np.array([OFF_M, 0.0, 0.0]))
    measurements = []
    for k, motion in enumerate(se2.between(drive.poses[:-1], drive.poses[1:])):
        sigma_m = between_passes_m if k == len(first.times) - 1 else 0.02
        covariance = np.diag([sigma_m**2, sigma_m**2, (0.01 * sigma_m) ** 2])
        measurements.append(Measurement(float(drive.times[k]), float(drive.times[k + 1]), motion, covariance))
    return Scans(tuple(drive.scans), 0, 0.25), Problem(measurements, [])


def closed(period_m: float, between_passes_m: float) -> LoopSearch:
    """Returns the loops of the passes that `drifted` makes."""
    scans, problem = drifted(period_m, between_passes_m)
    return find_loops(scans, problem, CONFIG.estimator, BEAM, Runner(), recognising=False)


def assert_right(loops: Sequence[Loop]) -> None:
    """Checks that loops have the later pass where it was."""
    for loop in loops:
        truth = 2.0 * (loop.later - 30 - loop.earlier)
        assert loop.pose[0] == pytest.approx(truth, abs=0.1) and loop.pose[1] == pytest.approx(0.0, abs=0.1)


def test_passes_that_a_wrong_but_honest_trajectory_allows_are_tied_where_they_belong() -> None:
    search = closed(60.0, 5.0)
    assert len(search.loops) >= 5 and search.warnings == []
    assert_right(search.loops)


def test_passes_of_a_street_that_repeats_are_hardly_ever_tied_and_that_is_said() -> None:
    search = closed(8.0, 5.0)
    assert search.ambiguous >= 5 > len(search.loops)
    assert_right(search.loops)  # where a pass ends, so does the repetition
    assert search.warnings == [f"loops: {search.ambiguous} pairs of passes were left out, because several places fit"]


def test_passes_that_a_trajectory_too_sure_of_itself_rules_out_are_not_tied_and_that_is_said() -> None:
    search = closed(60.0, 0.1)
    assert search.loops == [] and search.implausible >= 5
    assert search.warnings == [
        f"loops: {search.implausible} pairs of passes were left out, because the only place that fits is ruled out by the "
        "trajectory"
    ]


def test_passes_that_the_trajectory_does_not_know_well_enough_are_not_compared_and_that_is_said() -> None:
    search = closed(60.0, 20.0)
    assert search.loops == [] and search.tried == 0 and search.unsure >= 5
    (warning,) = search.warnings
    assert "the search for loops cannot cover the uncertainty" in warning


def test_the_search_goes_on_as_long_as_loops_bring_others_within_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    find = closing.find_candidates
    monkeypatch.setattr(closing, "find_candidates", lambda *arguments: (find(*arguments)[0][:1], []))
    search = closed(60.0, 5.0)
    assert len(search.loops) >= 5
    assert_right(search.loops)


def test_a_few_pairs_left_out_beside_many_loops_are_no_warning() -> None:
    loops = [Loop(0, k, np.zeros(3), np.eye(3), 0.8, 0.5) for k in range(100, 110)]
    assert LoopSearch(loops, 20, ambiguous=3, implausible=3, unsure=3).warnings == []


def test_every_recognition_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The counts of what recognition compared and could not use are those of all its calls, not of the last one."""
    answers = iter([Recognition([], [40, 50], 7), Recognition([], [50], 5)])
    monkeypatch.setattr(closing, "recognise", lambda *arguments: next(answers))
    scans, problem = drifted(60.0, 20.0)
    closer = closing.LoopCloser(problem, lambda poses: TrackedRun.of(scans, poses), CONFIG.estimator, BEAM, Runner())
    assert not closer.look_everywhere() and not closer.look_everywhere()
    search = closer.conclude()
    assert (search.tried, search.ambiguous, search.alike, search.implausible) == (12, 0, 2, 0)


def test_one_pair_left_out_is_one_pair() -> None:
    (warning,) = LoopSearch([], 1, ambiguous=1).warnings
    assert warning == "loops: 1 pair of passes was left out, because several places fit"
    warnings = LoopSearch([], 9, ambiguous=2, alike=1).warnings
    assert warnings == [
        "loops: 2 pairs of passes were left out, because several places fit",
        "loops: 1 submap was left out, because several places fit",
    ]
