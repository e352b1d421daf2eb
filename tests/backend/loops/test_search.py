"""Loops are places that fit and that the trajectory allows, and stay only where the map is better with them."""

from __future__ import annotations

import numpy as np
import pytest
from support.chains import candidate_of, chain_of, fenced_street
from support.passes import BEAM, CONFIG, LANE_Y, MIDDLE, OTHER_LANE_Y, joined, let_passes_follow, street_pass

from mqslam.backend.loops.closing import Candidate, CandidateScore, compare_passes, confirm_by_map, find_candidates
from mqslam.backend.loops.passes import SUBMAP_M, TrackedRun, render_submap
from mqslam.backend.loops.registration import align, score_at_pose
from mqslam.core import se2
from mqslam.core.measurement import Loop
from mqslam.execution.local_engine import HERE, LocalEngine
from mqslam.execution.progress import ignore_progress
from mqslam.psi.score import make_references


def two_passes(later: tuple[float, float, float], wrong: tuple[float, float, float]) -> tuple[TrackedRun, se2.Array]:
    """Returns two passes over a street, the later one drifted by (x, y, yaw) of its first pose, and the true poses."""
    first, second = street_pass(-25.0, LANE_Y, 0.0, 1), street_pass(*later, 2)
    local = se2.between(second.poses[0], second.poses)
    drifted = se2.compose(second.poses[0] + np.array(wrong), local)
    return joined(first, second, drifted), joined(first, second).poses


SAME, OPPOSITE = (-22.0, LANE_Y, 0.0), (15.0, OTHER_LANE_Y, np.pi)
KEEP = (CONFIG.estimator, BEAM)


near_passes = let_passes_follow(35.0)  # each pass of the tests is 40 m long


def compared(drive: TrackedRun, candidates: list[Candidate]) -> list[CandidateScore]:
    """Returns what psi says about candidates of a drive."""
    return compare_passes(drive, candidates, CONFIG.estimator, BEAM, HERE, ignore_progress)


def candidates_of(drive: TrackedRun) -> list[Candidate]:
    """Returns the candidates of a drive that is sure of its motions, but only to 2 m of that between its passes."""
    return find_candidates(chain_of(drive, between_passes=2.0), set())[0]


@pytest.mark.parametrize("later", [SAME, OPPOSITE])
def test_loops_found_are_true(later: tuple[float, float, float]) -> None:
    drive, truth = two_passes(later, (1.5, -1.0, 0.02))
    loops = [comparison.loop for comparison in compared(drive, candidates_of(drive)) if comparison.loop]
    assert len(loops) >= 3
    for loop in loops:
        error = loop.pose - se2.between(truth[loop.earlier], truth[loop.later])
        assert np.hypot(error[0], error[1]) < 0.1 and abs(se2.wrap(error[2])) < 0.005


def test_places_that_only_seem_near_are_no_loops() -> None:
    """The later pass is in another street, and has drifted onto the first."""
    first, second = street_pass(-25.0, LANE_Y, 0.0, 1), street_pass(-25.0, 37.75, 0.0, 3)
    drive = joined(first, second, second.poses + np.array([0.0, LANE_Y - 37.75, 0.0]))
    comparisons = compared(drive, candidates_of(drive))
    assert len(comparisons) >= 5
    assert not any(comparison.loop for comparison in comparisons)


def test_a_match_that_the_trajectory_rules_out_is_no_loop() -> None:
    drive, _ = two_passes(SAME, (1.5, -1.0, 0.0))
    pair = MIDDLE, len(street_pass(-25.0, LANE_Y, 0.0, 1).times) + MIDDLE
    (allowed,), (ruled_out,) = (compared(drive, [candidate_of(drive, pair, sigma)]) for sigma in (1.0, 0.1))
    assert allowed.loop and not allowed.implausible
    assert ruled_out == CandidateScore(implausible=True)


@pytest.mark.parametrize("off_m", [0.0, 3.0, 8.0])
def test_a_street_that_repeats_holds_no_loop_wherever_the_trajectory_has_it(off_m: float) -> None:
    first, second = fenced_street(8.0, 1), fenced_street(8.0, 2)
    drive = joined(first, second, second.poses + np.array([off_m, 0.0, 0.0]))
    middle = len(first.times) // 2
    (result,) = compared(drive, [candidate_of(drive, (middle, len(first.times) + middle), 4.0)])
    assert result == CandidateScore(ambiguous=True)


def test_a_street_that_does_not_repeat_within_the_search_holds_a_loop() -> None:
    first, second = fenced_street(60.0, 1), fenced_street(60.0, 2)
    drive = joined(first, second, second.poses + np.array([8.0, 0.0, 0.0]))
    middle = len(first.times) // 2
    (result,) = compared(drive, [candidate_of(drive, (middle, len(first.times) + middle), 4.0)])
    assert result.loop and np.hypot(*result.loop.pose[:2]) < 0.1


def loop_at(drive: TrackedRun, earlier: int, later: int, pose: se2.Array) -> Loop:
    """Returns a loop at a pose (3,), with the score it has there."""
    reference = render_submap(drive, earlier, SUBMAP_M, BEAM)
    query = render_submap(drive, later, 0.5 * SUBMAP_M, BEAM)
    psi = score_at_pose(make_references(reference), query, pose, CONFIG.estimator)
    return Loop(earlier, later, pose, 1e-4 * np.eye(3), 0.8, psi)


def test_the_map_keeps_a_right_loop_and_drops_one_that_makes_it_worse() -> None:
    drive, truth = two_passes(SAME, (0.4, -0.3, 0.01))
    a, b = MIDDLE, len(street_pass(-25.0, LANE_Y, 0.0, 1).times) + MIDDLE
    right = loop_at(drive, a, b, se2.between(truth[a], truth[b]))
    assert confirm_by_map([right], drive, truth, *KEEP, HERE) == [right]

    wrong = loop_at(drive, a, b, right.pose + np.array([0.0, 3.0, 0.0]))
    follows = truth.copy()
    follows[len(truth) - len(truth) // 2 :, 1] += 3.0  # the later pass is drawn to where the loop has it
    before = TrackedRun.of(drive.scans, truth)
    assert confirm_by_map([wrong], before, follows, *KEEP, HERE) == []
    assert confirm_by_map([right], before, follows, *KEEP, HERE) == []  # right, but the graph did not heed it


def test_a_loop_that_the_graph_heeds_by_half_stays_for_the_map_is_better_with_it() -> None:
    drive, truth = two_passes(SAME, (0.4, -0.3, 0.0))
    a, b = MIDDLE, len(street_pass(-25.0, LANE_Y, 0.0, 1).times) + MIDDLE
    right = loop_at(drive, a, b, se2.between(truth[a], truth[b]))
    half = 0.5 * (drive.poses + truth)
    assert confirm_by_map([right], drive, half, *KEEP, HERE) == [right]
    assert confirm_by_map([right], TrackedRun.of(drive.scans, half), drive.poses, *KEEP, HERE) == []


def test_the_map_judges_each_loop_by_its_own_place() -> None:
    drive, truth = two_passes(SAME, (0.4, -0.3, 0.01))
    a, b = MIDDLE, len(street_pass(-25.0, LANE_Y, 0.0, 1).times) + MIDDLE
    right = [loop_at(drive, a + k, b + k, se2.between(truth[a + k], truth[b + k])) for k in (-4, 0, 4)]
    assert confirm_by_map(right, drive, truth, *KEEP, LocalEngine(2)) == right
    assert confirm_by_map(right, TrackedRun.of(drive.scans, truth), drive.poses, *KEEP, LocalEngine(2)) == []


def test_a_loop_that_only_confirms_a_good_map_stays() -> None:
    _, truth = two_passes(SAME, (0.0, 0.0, 0.0))
    drive = two_passes(SAME, (0.0, 0.0, 0.0))[0]
    a, b = MIDDLE, len(street_pass(-25.0, LANE_Y, 0.0, 1).times) + MIDDLE
    reference = render_submap(drive, a, SUBMAP_M, BEAM)
    query = render_submap(drive, b, 0.5 * SUBMAP_M, BEAM)
    pose = se2.between(truth[a], truth[b])
    result = align(make_references(reference), query, pose, (3.0, 0.03), CONFIG.estimator)
    loop = Loop(a, b, result.pose, result.covariance, result.matched, result.psi)
    nudged = truth.copy()
    nudged[len(truth) // 2 :, 0] += 0.02  # within what the graph may weigh it against
    assert confirm_by_map([loop], drive, nudged, *KEEP, HERE) == [loop]
