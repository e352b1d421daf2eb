"""How long turns take is measured from the azimuths' own stamps, however few polar scans there are, whatever is missing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.conversions import STAMPED, Turns, angles_of, convert, spinning, stamps_of
from support.recordings import START_US

from mqslam.core.recording import PolarScan, Recording
from mqslam.detection.stage import make_scans
from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.layout import Stamp
from mqslam.formats.recordings.turns import find_usual_turns, measure_turn, place_turns

DATA = Path(__file__).parents[4] / "shared" / "data"


def written(recording: Recording, folder: Path, layout: str) -> Recording:
    """Writes a recording and reads it back in a layout that stamps its files only; older native files state no durations."""
    out, _ = convert(recording, folder, layout)
    if layout == "native":
        with np.load(out) as archive:
            members = {name: archive[name] for name in archive.files if name != "turns_us"}
        np.savez(out, **members, end_us=np.int64(recording.end_us))
    return open_recording(out)


@pytest.mark.parametrize("azimuths", [180, 400, 5600])
@pytest.mark.parametrize("burst", [1, 4, 16])
@pytest.mark.parametrize("rate_hz", [0.4, 4.0, 10.0])
def test_a_turn_is_measured_through_bursts_of_stamps(azimuths: int, burst: int, rate_hz: float) -> None:
    turn = measure_turn(stamps_of(azimuths, 1e6 / rate_hz, burst), angles_of(azimuths))
    assert turn == pytest.approx(1e6 / rate_hz, rel=0.015)


def test_a_part_that_is_missing_late_stamps_and_either_sense_of_rotation_change_nothing() -> None:
    stamps, angles = stamps_of(400, 250_000.0, 16), angles_of(400)
    for kept in (slice(0, 150), slice(200, None), np.r_[0:100, 260:400]):
        assert measure_turn(stamps[kept], angles[kept]) == pytest.approx(250_000.0, rel=0.03)
    late = np.maximum.accumulate(np.where(np.arange(400) % 97 == 0, stamps + 20_000.0, stamps))
    assert measure_turn(late, angles) == pytest.approx(250_000.0, rel=0.1)
    stamps[-5:] += 2e6
    assert measure_turn(stamps, -angles) == pytest.approx(250_000.0, rel=0.02)


@pytest.mark.parametrize(
    ("stamps", "angles"),
    [
        (stamps_of(7, 250_000.0), angles_of(7)),
        (np.zeros(400), angles_of(400)),
        (stamps_of(400, 250_000.0), np.zeros(400)),
        (stamps_of(400, 2500.0), angles_of(400)),
        (stamps_of(400, 2.5e8), angles_of(400)),
        (np.zeros(0), np.zeros(0)),
    ],
)
def test_azimuths_that_no_radar_sweeps_like_that_measure_nothing(
    stamps: NDArray[np.float64], angles: NDArray[np.float64]
) -> None:
    assert measure_turn(stamps, angles) is None


@pytest.mark.parametrize("layout", STAMPED)
@pytest.mark.parametrize("turn_us", [100_000, 250_000, 2_500_000])
def test_a_gap_after_the_first_of_three_polar_scans_is_no_turn(tmp_path: Path, layout: str, turn_us: int) -> None:
    recording = written(spinning([0, 9 * turn_us, 10 * turn_us], turn_us), tmp_path, layout)
    assert recording.revolution_s == pytest.approx(turn_us * 1e-6, rel=0.05)
    ((after, missing),) = recording.gaps()
    assert after == 0 and missing == pytest.approx(8 * turn_us * 1e-6, rel=0.05)
    first, second, _ = make_scans(recording)
    assert first.t1 == pytest.approx(turn_us * 1e-6, rel=0.05)
    assert second.t0 - first.t1 == pytest.approx(missing)


@pytest.mark.parametrize("layout", STAMPED)
def test_one_and_two_polar_scans_tell_their_turn_rate(tmp_path: Path, layout: str) -> None:
    for count in (1, 2):
        recording = written(spinning([0, 60_000_000][:count], 400_000), tmp_path / f"{count}", layout)
        assert recording.revolution_s == pytest.approx(0.4, rel=0.05)
        assert [after for after, _ in recording.gaps()] == [0][: count - 1]


@pytest.mark.parametrize("layout", ["oxford", "mulran_oxford", "rosbag1", "native"])
def test_a_recording_of_every_second_polar_scan_has_gaps_and_no_slow_radar(tmp_path: Path, layout: str) -> None:
    recording = written(spinning(list(range(0, 12_000_000, 500_000)), 250_000), tmp_path, layout)
    assert recording.revolution_s == pytest.approx(0.25, rel=0.05)
    assert len(recording.gaps()) == 23 and recording.gaps()[0][1] == pytest.approx(0.25, rel=0.05)


def test_the_azimuths_of_a_few_polar_scans_tell_each_turn_rate(tmp_path: Path) -> None:
    turns = spinning([0, 500_000, 1_000_000, 1_250_000], [500_000, 500_000, 250_000, 250_000])
    recording = written(turns, tmp_path, "oxford")
    assert recording.gaps() == [] and recording.turns_us[:3].tolist() == [500_000, 500_000, 250_000]


def test_a_radar_that_is_told_to_turn_slower_for_a_while_leaves_no_gaps(tmp_path: Path) -> None:
    takes = [250_000] * 12 + [500_000] * 12 + [250_000] * 12
    recording = written(spinning([0, *np.cumsum(takes[:-1]).tolist()], takes), tmp_path, "oxford")
    assert recording.gaps() == [] and recording.turns_us[:-1].tolist() == takes[:-1]


def test_a_last_polar_scan_that_breaks_off_takes_a_turn_all_the_same(tmp_path: Path) -> None:
    whole = spinning([0, 250_000, 500_000], 250_000)
    half = PolarScan(*(getattr(whole.turns[2], name)[:35] for name in ("times", "azimuths", "power", "valid")))
    cut = Turns(**{**{name: getattr(whole, name) for name in whole.__dataclass_fields__}, "turns": (*whole.turns[:2], half)})
    recording = written(cut, tmp_path, "oxford")
    assert recording.turns_us[2] == pytest.approx(250_000, rel=0.05)
    assert recording.duration_s == pytest.approx(0.75, rel=0.02)


@pytest.mark.parametrize(
    ("steps", "usual"),
    [
        ([250_000], 250_000),
        ([250_000, 2_000_000], 250_000),
        ([2_000_000, 250_000], 250_000),
        ([2_000_000, 250_000, 2_000_000, 750_000], 250_000),
        ([60_000_000], 250_000),
        ([1, 1, 1], 250_000),
        ([1] * 30, 250_000),
        ([7_200_000_000, 2_500_000, 2_500_000], 2_500_000),
    ],
)
def test_few_stamps_tell_the_turn_as_far_as_they_can(steps: list[int], usual: int) -> None:
    stamps = np.cumsum([0, *steps])
    assert np.all(find_usual_turns(stamps) == usual)
    for stamp in ("start", "end"):
        starts, turns = place_turns(stamps, stamp, find_usual_turns(stamps))  # type: ignore[arg-type]
        assert np.all(turns > 0) and np.all(np.diff(starts) > 0)


@pytest.mark.parametrize("missing", [0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
@pytest.mark.parametrize("turn_us", [100_000, 250_000, 2_500_000])
def test_polar_scans_that_are_missing_anywhere_are_gaps_by_stamps_alone(missing: float, turn_us: int) -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        numbers = np.flatnonzero(rng.random(80) >= missing)
        stamps = numbers * turn_us + rng.normal(0.0, 0.02 * turn_us, len(numbers)).round().astype(np.int64)
        starts, turns = place_turns(stamps, "start", find_usual_turns(stamps))
        np.testing.assert_array_equal(np.diff(starts) > turns[:-1], np.diff(numbers) > 1)
        assert np.median(turns) == pytest.approx(turn_us, rel=0.05)


def test_a_change_of_the_turn_rate_shows_in_stamps_alone_and_is_no_gap() -> None:
    rng = np.random.default_rng(5)
    takes = np.array([500_000] * 15 + [250_000] * 20 + [100_000] * 15)
    stamps = np.cumsum(takes) + rng.normal(0.0, 2000.0, len(takes)).round().astype(np.int64)
    starts, turns = place_turns(stamps, "start", find_usual_turns(stamps))
    assert np.all(np.diff(starts) == turns[:-1])
    np.testing.assert_allclose(find_usual_turns(stamps), takes[1:], rtol=0.1)


@pytest.mark.parametrize(("name", "gap", "missing"), [("mulran_kaist03", 1, 1.748), ("oxford_gap", 10, 1.762)])
def test_real_recordings_with_a_gap_turn_at_4_hz(name: str, gap: int, missing: float) -> None:
    if not (DATA / name).is_dir():
        pytest.skip(f"the real sample is not at {DATA / name}")
    recording = open_recording(DATA / name)
    assert 1.0 / recording.revolution_s == pytest.approx(4.0, abs=0.03)
    assert recording.gaps() == [(gap, pytest.approx(missing, abs=0.005))]
    after = make_scans(recording)[gap + 1]
    assert after.t1 - after.t0 == pytest.approx(0.25, abs=0.005)


@given(
    st.lists(st.one_of(st.integers(1, 3_000_000), st.sampled_from([250_000, 500_000, 60_000_000])), max_size=40),
    st.sampled_from(["start", "end"]),
    st.one_of(st.none(), st.floats(50_000.0, 5_000_000.0)),
)
@settings(max_examples=200, deadline=None, derandomize=True)
def test_any_stamps_make_turns_that_follow_one_another(steps: list[int], stamp: Stamp, measured: float | None) -> None:
    stamps = START_US + np.cumsum([0, *steps])
    starts, turns = place_turns(stamps, stamp, find_usual_turns(stamps, lambda k: measured))
    assert len(starts) == len(turns) == len(stamps) and turns.dtype == np.int64
    assert np.all(turns > 0) and np.all(np.diff(starts) > 0)
    np.testing.assert_array_equal(starts if stamp == "start" else starts + turns, stamps)
    recording = replace(spinning([0], 250_000), stamps_us=starts, turns_us=turns)
    assert 0.0499 < recording.revolution_s < 5.001 and recording.duration_s > 0.0
    assert np.all(recording.ends_us > starts) and np.all(recording.ends_us[:-1] <= starts[1:])
    assert all(missing > 0.0 for _, missing in recording.gaps())
