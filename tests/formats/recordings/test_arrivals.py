"""Arrival stamps are freed of their jitter as far as a turning mass allows, and of nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.conversions import EVEN, arriving, convert, spinning, write_jittered
from support.recordings import START_US, TURN_US

from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.arrivals import estimate_arrivals

Stamps = NDArray[np.int64]


def turning(takes_us: NDArray[np.float64] | NDArray[np.int64]) -> Stamps:
    """Returns stamps of polar scans whose turns take so long."""
    return np.asarray(START_US + np.cumsum(takes_us).round().astype(np.int64))


def smooth_arrivals(stamps: Stamps) -> tuple[Stamps, list[str]]:
    """Returns the stamps that take the place of those of arrival, and the notes."""
    arrivals = estimate_arrivals(stamps)
    return arrivals.stamps_us, list(arrivals.notes)


def delays_of(kind: str, count: int, seed: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    delays = {
        "uniform": rng.uniform(0.0, 20_000.0, count),
        "normal": rng.normal(10_000.0, 6000.0, count),
        "late": rng.normal(5000.0, 3000.0, count) + np.where(rng.random(count) < 0.05, 80_000.0, 0.0),
    }
    return delays[kind]


def rms(errors: NDArray[np.int64]) -> float:
    """Returns the root mean square [us] without the delay that all stamps share, which nobody can tell."""
    return float(np.sqrt(np.mean((errors - np.median(errors)) ** 2)))


@pytest.mark.parametrize("kind", ["uniform", "normal", "late"])
@pytest.mark.parametrize("turn_us", [100_000, 250_000, 2_500_000])
def test_jitter_of_a_steady_radar_falls_to_a_third_at_most(kind: str, turn_us: int) -> None:
    for seed in range(3):
        turns = turning(np.full(200, turn_us))
        stamps = arriving(turns, delays_of(kind, 200, seed))
        smooth, (note,) = smooth_arrivals(stamps)
        assert rms(smooth - turns) < rms(stamps - turns) / 3.0
        moved = (smooth - stamps) * 1e-3
        assert f"by {np.sqrt(np.mean(moved**2)):.1f} ms (RMS) and at most by {np.abs(moved).max():.1f} ms" in note


def test_eighteen_polar_scans_are_enough_for_durations_of_turns_that_can_be_used() -> None:
    turns = turning(np.full(18, TURN_US))
    ratios = []
    for seed in range(20):
        stamps = arriving(turns, delays_of("normal", 18, seed))
        ratios.append(np.std(np.diff(estimate_arrivals(stamps).stamps_us)) / np.std(np.diff(stamps)))
    assert np.mean(ratios) < 0.15 and max(ratios) < 0.6


def test_a_rate_that_wanders_is_followed() -> None:
    wander = TURN_US * (1.0 + 0.02 * np.sin(np.arange(400) / 60.0))
    turns = turning(wander)
    stamps = arriving(turns, delays_of("normal", 400, 1))
    smooth, _ = smooth_arrivals(stamps)
    assert rms(smooth - turns) < rms(stamps - turns) / 3.0
    assert np.abs(np.diff(smooth) - wander[1:]).max() < 1500.0


def test_a_turn_rate_that_is_commanded_is_not_smeared() -> None:
    takes = np.repeat([500_000, 250_000], 40)
    for seed in range(5):
        turns = turning(takes)
        smooth, _ = smooth_arrivals(arriving(turns, delays_of("normal", 80, seed)))
        assert np.abs(np.diff(smooth) - takes[1:]).max() < 2500.0


@pytest.mark.parametrize(
    "takes",
    [
        np.full(300, TURN_US),
        np.full(300, 1e6 / 7.0),
        np.repeat([500_000, 250_000], 40),
        TURN_US * (1.0 + 0.02 * np.sin(np.arange(300) / 10.0)),
        TURN_US * np.where(np.arange(100) == 50, 9, 1),
        TURN_US * np.where(np.arange(100) % 3 == 0, 2, 1),
        TURN_US + np.random.default_rng(1).normal(0.0, 100.0, 300).cumsum(),
    ],
)
def test_stamps_that_do_not_jitter_stay_as_they_are(takes: NDArray[np.float64]) -> None:
    stamps = turning(takes)
    smooth, notes = smooth_arrivals(stamps)
    assert notes == []
    np.testing.assert_array_equal(smooth, stamps)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_up_to_three_polar_scans_cannot_tell_jitter(count: int) -> None:
    stamps = arriving(turning(np.full(count, TURN_US)), delays_of("uniform", count, 1))
    assert estimate_arrivals(stamps).stamps_us.tolist() == stamps.tolist()


@pytest.mark.parametrize("missing_us", [TURN_US, 60_000_000, 7_200_000_000, 77_777])
def test_a_gap_a_pause_and_a_jump_of_the_clock_stay_where_they_are(missing_us: int) -> None:
    turns = turning(np.where(np.arange(100) == 50, TURN_US + missing_us, TURN_US))
    stamps = arriving(turns, delays_of("uniform", 100, 3))
    smooth, _ = smooth_arrivals(stamps)
    for half in (slice(0, 50), slice(50, None)):
        assert rms((smooth - turns)[half]) < rms((stamps - turns)[half]) / 2.0


def test_polar_scans_that_are_held_up_together_are_put_back_and_leave_no_gap() -> None:
    turns = turning(np.full(60, TURN_US))
    delays = delays_of("normal", 60, 2)
    delays[30:33] += [600_000.0, 350_000.0, 100_000.0]
    smooth, _ = smooth_arrivals(arriving(turns, delays))
    assert np.abs(np.diff(smooth) - TURN_US).max() < 5000.0


def busy(count: int, seed: int) -> NDArray[np.float64]:
    """Returns delays [us] of a computer that is busy at times: every eighth stamp is late, some by more than a turn."""
    rng = np.random.default_rng(seed)
    delays = rng.exponential(4000.0, count) + rng.normal(5000.0, 2500.0, count)
    delays += np.where(rng.random(count) < 0.12, rng.exponential(200_000.0, count), 0.0)
    for first in np.flatnonzero(rng.random(count) < 0.01).tolist():  # what waits is handed over together
        wait = rng.uniform(200_000.0, 900_000.0) - 0.98 * TURN_US * np.arange(min(6, count - first))
        delays[first : first + 6] += np.maximum(wait, 0.0)
    return delays


def test_stamps_behind_the_next_ones_are_put_back_and_no_polar_scan_is_lost() -> None:
    drift = TURN_US * (1.0 + 0.003 * np.sin(np.arange(700) / 200.0))
    for seed in range(4):
        turns = turning(drift)
        stamps = turns + busy(700, seed).astype(np.int64)
        assert np.count_nonzero(np.diff(stamps) <= 0) > 10
        arrivals = estimate_arrivals(stamps)
        assert rms(arrivals.stamps_us - turns) < 2500.0 and arrivals.faults == ()
        assert np.abs(np.diff(arrivals.stamps_us) - drift[1:]).max() < 4000.0
        assert 0.0003 < arrivals.sigma_s < 0.003 and len(arrivals.notes) == 1


@pytest.mark.parametrize("gap_us", [500_000, 700_000, 1_500_000])
def test_gaps_between_late_stamps_stay_where_they_are(gap_us: int) -> None:
    places = [100, 180, 333, 471, 555]
    right = 0
    for seed in range(4):
        turns = turning(TURN_US + np.where(np.isin(np.arange(650), places), gap_us, 0))
        errors = estimate_arrivals(turns + busy(650, seed).astype(np.int64)).stamps_us - turns
        errors -= round(float(np.median(errors)))
        right += np.count_nonzero(np.abs(errors) < 60_000)
        assert np.all(np.abs(errors[places]) < 60_000)
    assert right >= 4 * 650 - 6  # a late polar scan before a gap can as well be one after it


def test_polar_scans_that_are_missing_by_their_numbers_keep_the_others_in_place() -> None:
    numbers = np.flatnonzero(np.random.default_rng(2).random(300) > 0.2) + 1
    turns = turning(np.full(300, TURN_US))[numbers - 1]
    stamps = turns + busy(300, 6)[numbers - 1].astype(np.int64)
    arrivals = estimate_arrivals(stamps, numbers)
    assert rms(arrivals.stamps_us - turns) < 2500.0


def test_a_run_of_late_stamps_does_not_bend_the_turns_before_and_after_it() -> None:
    turns = turning(np.full(200, TURN_US))
    delays = delays_of("normal", 200, 4)
    delays[:5] += [76_000.0, 290_000.0, 57_000.0, 53_000.0, 425_000.0]
    delays[100:104] += [700_000.0, 62_000.0, 43_000.0, 23_000.0]
    smooth = estimate_arrivals(turns + delays.astype(np.int64)).stamps_us
    assert np.abs(np.diff(smooth) - TURN_US).max() < 1000.0


@pytest.mark.parametrize("count", [2, 3, 4, 5])
def test_a_few_polar_scans_with_late_stamps_all_stay(count: int) -> None:
    for late in range(count):
        stamps = turning(np.full(count, TURN_US))
        stamps[late] += 700_000
        arrivals = estimate_arrivals(stamps)
        assert len(arrivals.stamps_us) == count and np.all(np.diff(arrivals.stamps_us) > 0) and arrivals.faults == ()
    assert np.all(np.diff(estimate_arrivals(np.full(count, START_US)).stamps_us) > 0)


@pytest.mark.parametrize("off_s", [-1_000_000, -60, -0.9, 30, 1_000_000])
def test_a_damaged_stamp_is_said_and_its_turn_estimated_from_those_around(off_s: float) -> None:
    turns = turning(np.full(100, TURN_US))
    stamps = turns.copy()
    stamps[40] += round(off_s * 1e6)
    arrivals = estimate_arrivals(stamps)
    (fault,) = arrivals.faults
    assert fault.startswith("the stamp of polar scan number 41 among 100 lies too far from the stamps around it")
    assert arrivals.notes == () and np.abs(arrivals.stamps_us - turns).max() <= 1


@given(st.lists(st.integers(-3_000_000, 3_000_000), min_size=1, max_size=40))
@settings(max_examples=150, deadline=None, derandomize=True)
def test_any_stamps_out_of_order_are_put_in_order(delays: list[int]) -> None:
    stamps = turning(np.full(len(delays), TURN_US)) + np.array(delays)
    smooth = estimate_arrivals(stamps).stamps_us
    assert len(smooth) == len(stamps) and np.all(np.diff(smooth) > 0)


@given(st.lists(st.integers(1, 2_000_000), min_size=1, max_size=40), st.sampled_from([1, 1000, 10**9]))
@settings(max_examples=150, deadline=None, derandomize=True)
def test_any_stamps_stay_in_order_and_smoothing_them_again_changes_nothing(steps: list[int], scale: int) -> None:
    stamps = START_US + np.cumsum(np.array(steps, dtype=np.int64) * scale)
    smooth, notes = smooth_arrivals(stamps)
    assert len(smooth) == len(stamps) and np.all(np.diff(smooth) > 0)
    assert bool(notes) == bool(np.any(smooth != stamps))
    np.testing.assert_array_equal(estimate_arrivals(smooth).stamps_us, smooth)


@pytest.mark.parametrize("layout", [*EVEN, "bag"])
def test_every_layout_of_one_stamp_per_polar_scan_is_smoothed_and_says_so(tmp_path: Path, layout: str) -> None:
    delays = delays_of("uniform", 60, 1)
    recording = open_recording(write_jittered(tmp_path, layout, delays))
    late = recording.stamps_us - START_US - TURN_US * np.arange(60)
    assert rms(late[1:]) < rms(delays[1:].astype(np.int64)) / 3.0
    assert np.abs(recording.turns_us[1:] - TURN_US).max() < 1000
    said = "the arrival stamps jitter more than a turning radar can"
    (note,) = (note for note in recording.notes if note.startswith(said))
    assert " ms (RMS) and at most by " in note
    for k in (1, 30, 59):
        assert recording[k].times[0] == pytest.approx(recording.start_times[k], abs=1e-6)
        assert np.ptp(recording[k].times) == pytest.approx(0.25 * 59 / 60, abs=1e-3)


@pytest.mark.parametrize("layout", [*EVEN, "bag"])
def test_stamps_without_jitter_are_read_as_they_are_and_nothing_is_said(tmp_path: Path, layout: str) -> None:
    recording = open_recording(write_jittered(tmp_path, layout, np.zeros(12)))
    np.testing.assert_array_equal(recording.stamps_us, START_US + TURN_US * np.arange(12))
    assert not any("jitter" in note for note in recording.notes)


@pytest.mark.parametrize("first", [*EVEN, "bag"])
@pytest.mark.parametrize("second", [*EVEN, "oxford", "native", "mcap"])
def test_smoothed_stamps_are_written_and_read_back_equal(tmp_path: Path, first: str, second: str) -> None:
    recording = open_recording(write_jittered(tmp_path, first, delays_of("late", 40, 3)), range_resolution=0.5)
    back = open_recording(convert(recording, tmp_path / "there", second)[0])
    assert any("jitter" in note for note in recording.notes)
    np.testing.assert_array_equal(back.stamps_us[1:], recording.stamps_us[1:])
    np.testing.assert_array_equal(back.turns_us[1:-1], recording.turns_us[1:-1])


def test_azimuths_with_stamps_of_their_own_are_not_smoothed(tmp_path: Path) -> None:
    begins = arriving(turning(np.full(20, TURN_US)), delays_of("uniform", 20, 1))
    begins -= begins[0]
    recording = spinning(begins.tolist(), TURN_US - 30_000)
    for layout in ("oxford", "native", "b_scan"):
        back = open_recording(convert(recording, tmp_path / layout, layout)[0])
        np.testing.assert_array_equal(back.stamps_us, recording.stamps_us)
