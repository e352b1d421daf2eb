"""Loops are looked for where the path comes back, and stay only where the map is better with them."""

from __future__ import annotations

import numpy as np
import pytest
from support.passes import BEAM, CONFIG, LANE_Y, MIDDLE, OTHER_LANE_Y, joined, path, street_pass

from mqslam.backend.loops.align import align, score_at_pose
from mqslam.backend.loops.passes import compute_reach
from mqslam.backend.loops.search import confirm_by_map, find_candidate_pairs, find_loops
from mqslam.backend.loops.submap import Drive, pick_spaced, render_submap
from mqslam.config import LoopConfig
from mqslam.core import se2
from mqslam.core.measurement import Loop
from mqslam.execution.engine import HERE, LocalEngine
from mqslam.execution.progress import ignore_progress

RADIUS = 30.0
LAP_M = 2.0 * np.pi * RADIUS


def laps(number: float) -> Drive:
    """Returns rounds of a circle, a scan every two metres."""
    angles = np.arange(0.0, number * LAP_M, 2.0) / RADIUS
    return path(RADIUS * np.column_stack([np.cos(angles), np.sin(angles)]))


def there_and_back(length: float, apart: float) -> Drive:
    """Returns a straight drive, and the way back beside it."""
    there = np.arange(0.0, length, 2.0)
    return path(np.column_stack([np.r_[there, there[::-1]], np.repeat([0.0, apart], len(there))]))


def between_m(drive: Drive, pairs: list[tuple[int, int]]) -> np.ndarray:
    """Returns the path (N,) [m] between the scans of pairs."""
    return np.array([drive.travelled[b] - drive.travelled[a] for a, b in pairs])


def apart_m(drive: Drive, pairs: list[tuple[int, int]]) -> np.ndarray:
    return np.array([np.hypot(*(drive.poses[a] - drive.poses[b])[:2]) for a, b in pairs])


def test_every_place_of_a_second_lap_is_a_candidate_with_the_first() -> None:
    drive = laps(2.0)
    pairs = find_candidate_pairs(drive, CONFIG.loops, set())
    later = [k for k in pick_spaced(drive.travelled, CONFIG.loops.spacing_m) if drive.travelled[k] > LAP_M + 1.0]
    again = {b: a for a, b in pairs}
    assert all(k in again for k in later)
    full = [(again[k], int(k)) for k in later]
    # the end of the second lap is as near to its beginning as to the end of the first
    np.testing.assert_allclose(between_m(drive, full[:-1]), LAP_M, atol=0.5 * CONFIG.loops.spacing_m + 2.0)
    assert apart_m(drive, full).max() <= 0.5 * CONFIG.loops.spacing_m + 2.0
    assert all(type(k) is int for pair in pairs for k in pair)


def test_of_each_earlier_pass_one_scan_is_taken_and_of_so_many_passes_as_are_asked_for() -> None:
    drive = laps(3.0)
    pairs = find_candidate_pairs(drive, LoopConfig(passes=2), set())
    last = [
        k for k in pick_spaced(drive.travelled, CONFIG.loops.spacing_m) if 2.0 < (drive.travelled[k] - 1.0) / LAP_M < 2.9
    ]
    for k in last:
        result = sorted(between_m(drive, [pair for pair in pairs if pair[1] == k]) / LAP_M)
        np.testing.assert_allclose(result, [1.0, 2.0], atol=0.03)
    assert len({b for _, b in find_candidate_pairs(drive, LoopConfig(passes=1), set())}) == len({b for _, b in pairs})
    assert len(find_candidate_pairs(drive, LoopConfig(passes=1), set())) < len(pairs)


@pytest.mark.parametrize("least_path_m", [30.0, 60.0, 90.0])
def test_a_short_way_round_is_no_loop(least_path_m: float) -> None:
    drive = there_and_back(100.0, 6.0)
    pairs = find_candidate_pairs(drive, LoopConfig(least_path_m=least_path_m), set())
    assert least_path_m < between_m(drive, pairs).min() < least_path_m + 10.0


def test_an_open_path_has_no_candidates() -> None:
    assert find_candidate_pairs(laps(0.8), CONFIG.loops, set()) == []
    assert (
        find_candidate_pairs(path(np.column_stack([np.arange(0.0, 500.0, 2.0), np.zeros(250)])), CONFIG.loops, set()) == []
    )


def test_a_drive_that_never_moved_has_no_candidates() -> None:
    assert find_candidate_pairs(path(np.zeros((50, 2))), CONFIG.loops, set()) == []


def test_tried_pairs_are_not_tried_again() -> None:
    drive = laps(2.0)
    pairs = find_candidate_pairs(drive, CONFIG.loops, set())
    assert find_candidate_pairs(drive, CONFIG.loops, set(pairs)) == []
    assert find_candidate_pairs(drive, CONFIG.loops, set(pairs[::2])) == pairs[1::2]


def test_a_tried_pair_covers_its_neighbours() -> None:
    drive = laps(2.0)
    pairs = find_candidate_pairs(drive, CONFIG.loops, set())
    a, b = pairs[len(pairs) // 2]
    others = [pair for pair in pairs if pair != (a, b)]
    assert find_candidate_pairs(drive, CONFIG.loops, {(a - 10, b)}) == others  # 20 m back on the earlier pass
    assert find_candidate_pairs(drive, CONFIG.loops, {(a - 35, b)}) == pairs  # 70 m back: another place
    left = find_candidate_pairs(drive, CONFIG.loops, {(a, b - 1)})  # 2 m back on the later pass
    assert (a, b) not in left and {pair for pair in pairs if abs(pair[1] - b) > 3} <= set(left)


def test_drift_widens_the_reach_along_the_path() -> None:
    drive = there_and_back(500.0, 16.0)
    pairs = find_candidate_pairs(drive, LoopConfig(reach_m=12.0, drift=0.005), set())
    assert 800.0 <= between_m(drive, pairs).min() < 820.0  # 16 m - 12 m at 5 mm per metre
    assert find_candidate_pairs(drive, LoopConfig(reach_m=12.0, drift=0.0), set()) == []
    assert find_candidate_pairs(drive, LoopConfig(reach_m=12.0, drift=1.0, gate_m=15.0), set()) == []


def test_the_gate_grows_with_the_path_up_to_its_largest() -> None:
    config = LoopConfig(search_m=3.0, search_rad=0.03, drift=0.005, drift_rad=3e-5, gate_m=7.0, gate_rad=0.05)
    assert compute_reach(100.0, config) == pytest.approx((3.5, 0.033))
    assert compute_reach(1000.0, config) == (7.0, 0.05)


def two_passes(later: tuple[float, float, float], wrong: tuple[float, float, float]) -> tuple[Drive, se2.Array]:
    """Returns two passes over a street, the later one drifted by (x, y, yaw) of its first pose, and the true poses."""
    first, second = street_pass(-25.0, LANE_Y, 0.0, 1), street_pass(*later, 2)
    local = se2.between(second.poses[0], second.poses)
    drifted = se2.compose(second.poses[0] + np.array(wrong), local)
    return joined(first, second, drifted), joined(first, second).poses


SAME, OPPOSITE = (-22.0, LANE_Y, 0.0), (15.0, OTHER_LANE_Y, np.pi)
KEEP = (CONFIG.loops, CONFIG.estimator, BEAM)
CLOSE = LoopConfig(least_path_m=35.0)  # a pass is 40 m long


@pytest.mark.parametrize("later", [SAME, OPPOSITE])
def test_loops_found_are_true(later: tuple[float, float, float]) -> None:
    drive, truth = two_passes(later, (1.5, -1.0, 0.02))
    tried: set[tuple[int, int]] = set()
    result = find_loops(drive, CLOSE, CONFIG.estimator, BEAM, tried, HERE, ignore_progress)
    assert len(result) >= 3 and {(loop.earlier, loop.later) for loop in result} <= tried
    for loop in result:
        error = loop.pose - se2.between(truth[loop.earlier], truth[loop.later])
        assert np.hypot(error[0], error[1]) < 0.1 and abs(se2.wrap(error[2])) < 0.005


def test_the_number_of_jobs_changes_no_loop() -> None:
    drive, _ = two_passes(SAME, (1.5, -1.0, 0.02))
    one, two = (
        find_loops(drive, CLOSE, CONFIG.estimator, BEAM, set(), LocalEngine(jobs), ignore_progress) for jobs in (1, 2)
    )
    assert [(a.earlier, a.later) for a in one] == [(b.earlier, b.later) for b in two]
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.pose, b.pose)
        np.testing.assert_array_equal(a.covariance, b.covariance)


def test_places_that_only_seem_near_are_no_loops() -> None:
    """The later pass is in another street, and has drifted onto the first."""
    first, second = street_pass(-25.0, LANE_Y, 0.0, 1), street_pass(-25.0, 37.75, 0.0, 3)
    drive = joined(first, second, second.poses + np.array([0.0, LANE_Y - 37.75, 0.0]))
    tried: set[tuple[int, int]] = set()
    assert find_loops(drive, CLOSE, CONFIG.estimator, BEAM, tried, HERE, ignore_progress) == []
    assert len(tried) >= 5


def loop_at(drive: Drive, earlier: int, later: int, pose: se2.Array) -> Loop:
    """Returns a loop at a pose (3,), with the score it has there."""
    settings = CONFIG.loops
    reference = render_submap(drive, earlier, settings.submap_m, settings.spacing_m, BEAM)
    query = render_submap(drive, later, 0.5 * settings.submap_m, settings.spacing_m, BEAM)
    psi = score_at_pose(reference, query, pose, CONFIG.estimator)
    return Loop(earlier, later, pose, 1e-4 * np.eye(3), 0.8, psi)


def test_the_map_keeps_a_right_loop_and_drops_one_that_makes_it_worse() -> None:
    drive, truth = two_passes(SAME, (0.4, -0.3, 0.01))
    a, b = MIDDLE, len(street_pass(-25.0, LANE_Y, 0.0, 1).times) + MIDDLE
    right = loop_at(drive, a, b, se2.between(truth[a], truth[b]))
    assert confirm_by_map([right], drive, truth, *KEEP, HERE) == [right]

    wrong = loop_at(drive, a, b, right.pose + np.array([0.0, 3.0, 0.0]))
    follows = truth.copy()
    follows[len(truth) - len(truth) // 2 :, 1] += 3.0  # the later pass is drawn to where the loop has it
    before = Drive.of(drive.scans, truth)
    assert confirm_by_map([wrong], before, follows, *KEEP, HERE) == []
    assert confirm_by_map([right], before, follows, *KEEP, HERE) == []  # right, but the graph did not heed it


def test_a_loop_that_the_graph_heeds_by_half_stays_for_the_map_is_better_with_it() -> None:
    drive, truth = two_passes(SAME, (0.4, -0.3, 0.0))
    a, b = MIDDLE, len(street_pass(-25.0, LANE_Y, 0.0, 1).times) + MIDDLE
    right = loop_at(drive, a, b, se2.between(truth[a], truth[b]))
    half = 0.5 * (drive.poses + truth)
    assert confirm_by_map([right], drive, half, *KEEP, HERE) == [right]
    assert confirm_by_map([right], Drive.of(drive.scans, half), drive.poses, *KEEP, HERE) == []


def test_the_map_judges_each_loop_by_its_own_place() -> None:
    drive, truth = two_passes(SAME, (0.4, -0.3, 0.01))
    a, b = MIDDLE, len(street_pass(-25.0, LANE_Y, 0.0, 1).times) + MIDDLE
    right = [loop_at(drive, a + k, b + k, se2.between(truth[a + k], truth[b + k])) for k in (-4, 0, 4)]
    assert confirm_by_map(right, drive, truth, *KEEP, LocalEngine(2)) == right
    assert confirm_by_map(right, Drive.of(drive.scans, truth), drive.poses, *KEEP, LocalEngine(2)) == []


def test_a_loop_that_only_confirms_a_good_map_stays() -> None:
    _, truth = two_passes(SAME, (0.0, 0.0, 0.0))
    drive = two_passes(SAME, (0.0, 0.0, 0.0))[0]
    a, b = MIDDLE, len(street_pass(-25.0, LANE_Y, 0.0, 1).times) + MIDDLE
    settings = CONFIG.loops
    reference = render_submap(drive, a, settings.submap_m, settings.spacing_m, BEAM)
    query = render_submap(drive, b, 0.5 * settings.submap_m, settings.spacing_m, BEAM)
    pose = se2.between(truth[a], truth[b])
    result = align(reference, query, pose, (3.0, 0.03), CONFIG.loops, CONFIG.estimator)
    loop = Loop(a, b, result.pose, result.covariance, result.matched, result.psi)
    nudged = truth.copy()
    nudged[len(truth) // 2 :, 0] += 0.02  # within what the graph may weigh it against
    assert confirm_by_map([loop], drive, nudged, *KEEP, HERE) == [loop]
