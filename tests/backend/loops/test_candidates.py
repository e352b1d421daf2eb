"""Candidates of loops are the places that the path passes again, as far as the trajectory may be wrong about them."""

from __future__ import annotations

import numpy as np
import pytest
from support.chains import SURE, chain_of
from support.passes import path

from mqslam.backend.loops import closing as module
from mqslam.backend.loops import passes
from mqslam.backend.loops.chain import Relative
from mqslam.backend.loops.closing import compute_reach, find_candidates
from mqslam.backend.loops.passes import SPACING_M, TrackedRun
from mqslam.mapping.keyframing import pick_spaced

RADIUS = 30.0
LAP_M = 2.0 * np.pi * RADIUS


def laps(number: float) -> TrackedRun:
    """Returns rounds of a circle, a scan every two metres."""
    angles = np.arange(0.0, number * LAP_M, 2.0) / RADIUS
    return path(RADIUS * np.column_stack([np.cos(angles), np.sin(angles)]))


def there_and_back(length: float, apart: float) -> TrackedRun:
    """Returns a straight drive, and the way back beside it."""
    there = np.arange(0.0, length, 2.0)
    return path(np.column_stack([np.r_[there, there[::-1]], np.repeat([0.0, apart], len(there))]))


def pairs_of(
    drive: TrackedRun, tried: set[tuple[int, int]], sigmas: tuple[float, float, float] = SURE
) -> list[tuple[int, int]]:
    """Returns the candidates of a drive that is as sure of its motions as asked."""
    candidates, _ = find_candidates(chain_of(drive, sigmas), tried)
    return [(candidate.earlier, candidate.later) for candidate in candidates]


def between_m(drive: TrackedRun, pairs: list[tuple[int, int]]) -> np.ndarray:
    """Returns the path (N,) [m] between the scans of pairs."""
    return np.array([drive.travelled[b] - drive.travelled[a] for a, b in pairs])


def apart_m(drive: TrackedRun, pairs: list[tuple[int, int]]) -> np.ndarray:
    return np.array([np.hypot(*(drive.poses[a] - drive.poses[b])[:2]) for a, b in pairs])


def test_every_place_of_a_second_lap_is_a_candidate_with_the_first() -> None:
    drive = laps(2.0)
    pairs = pairs_of(drive, set())
    later = [k for k in pick_spaced(drive.travelled, SPACING_M) if drive.travelled[k] > LAP_M + 1.0]
    again = {b: a for a, b in pairs}
    assert all(k in again for k in later)
    full = [(again[k], int(k)) for k in later]
    # the end of the second lap is as near to its beginning as to the end of the first
    np.testing.assert_allclose(between_m(drive, full[:-1]), LAP_M, atol=0.5 * SPACING_M + 2.0)
    assert apart_m(drive, full).max() <= 0.5 * SPACING_M + 2.0
    assert all(type(k) is int for pair in pairs for k in pair)


def test_of_each_earlier_pass_one_scan_is_taken_and_of_so_many_passes_as_are_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drive = laps(3.0)
    alone = pairs_of(drive, set())
    monkeypatch.setattr(module, "_PASSES", 2)
    pairs = pairs_of(drive, set())
    last = [k for k in pick_spaced(drive.travelled, SPACING_M) if 2.0 < (drive.travelled[k] - 1.0) / LAP_M < 2.9]
    for k in last:
        result = sorted(between_m(drive, [pair for pair in pairs if pair[1] == k]) / LAP_M)
        np.testing.assert_allclose(result, [1.0, 2.0], atol=0.03)
    assert len({b for _, b in alone}) == len({b for _, b in pairs})
    assert len(alone) < len(pairs)


@pytest.mark.parametrize("least_path_m", [30.0, 60.0, 90.0])
def test_a_short_way_round_is_no_loop(least_path_m: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(passes, "LEAST_PATH_M", least_path_m)
    drive = there_and_back(100.0, 6.0)
    pairs = pairs_of(drive, set())
    assert least_path_m < between_m(drive, pairs).min() < least_path_m + 10.0


def test_an_open_path_has_no_candidates() -> None:
    assert pairs_of(laps(0.8), set()) == []
    assert pairs_of(path(np.column_stack([np.arange(0.0, 500.0, 2.0), np.zeros(250)])), set()) == []


def test_a_drive_that_never_moved_has_no_candidates() -> None:
    assert pairs_of(path(np.zeros((50, 2))), set()) == []


def test_tried_pairs_are_not_tried_again() -> None:
    drive = laps(2.0)
    pairs = pairs_of(drive, set())
    assert pairs_of(drive, set(pairs)) == []
    assert pairs_of(drive, set(pairs[::2])) == pairs[1::2]


def test_a_tried_pair_covers_its_neighbours() -> None:
    drive = laps(2.0)
    pairs = pairs_of(drive, set())
    a, b = pairs[len(pairs) // 2]
    others = [pair for pair in pairs if pair != (a, b)]
    assert pairs_of(drive, {(a - 10, b)}) == others  # 20 m back on the earlier pass
    assert pairs_of(drive, {(a - 35, b)}) == pairs  # 70 m back: another place
    left = pairs_of(drive, {(a, b - 1)})  # 2 m back on the later pass
    assert (a, b) not in left and {pair for pair in pairs if abs(pair[1] - b) > 3} <= set(left)


def test_uncertainty_widens_the_reach_along_the_path() -> None:
    drive = there_and_back(500.0, 16.0)
    unsure = (0.07, 0.07, 1e-6)  # after n motions of two metres 0.07 m times the root of n
    pairs = pairs_of(drive, set(), unsure)
    least_m = 2.0 * (4.0 / (3.0 * 0.07)) ** 2  # three standard deviations are the 4 m that the two lanes are too far apart
    assert least_m - 20.0 < between_m(drive, pairs).min() < least_m + 40.0
    assert pairs_of(drive, set()) == []


def test_pairs_that_the_trajectory_does_not_know_well_enough_are_said_and_not_compared() -> None:
    drive = laps(2.0)
    wild = (2.0, 2.0, 1e-3)
    candidates, unsure = find_candidates(chain_of(drive, wild), set())
    assert candidates == []
    assert set(unsure) >= set(pairs_of(drive, set()))


def test_the_search_reaches_as_far_as_the_trajectory_may_be_wrong_but_never_less_than_its_least() -> None:
    turned = np.array([[40.0, 24.0, 0.0], [24.0, 40.0, 0.0], [0.0, 0.0, 0.04]])  # 8 m along the diagonal, 4 m across it
    assert compute_reach(Relative(np.zeros(3), turned)) == pytest.approx((3.0 * 8.0, 3.0 * 0.2))
    assert compute_reach(Relative(np.zeros(3), 1e-6 * turned)) == pytest.approx((15.0, 0.03))
