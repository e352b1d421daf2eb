"""Stamps and azimuths that contradict a radar that keeps turning are suspicious, each by its own words."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.conversions import convert, spinning
from support.layouts import left_turn
from support.recordings import START_US, TURN_US, oxford_rows, with_metadata, write_oxford, write_png

from mqslam.check.checks import CheckFinding, CheckVerdict, check_azimuths, check_order, check_stamps
from mqslam.check.stretches import FollowedStretches, Steps, Stretch, follow, read_stretches
from mqslam.config import Config
from mqslam.core.recording import PolarScan, Recording
from mqslam.core.trajectory import Trajectory
from mqslam.formats.recordings import open_recording
from mqslam.psi.place import beam_of
from mqslam.simulator import SimulatedRecording

CONFIG = Config()
BEAM = beam_of(CONFIG.estimator, 0.0)


def stretches_of(recording: Recording, odometry: Trajectory | None = None) -> list[Stretch]:
    return read_stretches(recording, odometry, CONFIG.detector, lambda done, total: None)


def findings(recording: Recording) -> tuple[CheckFinding, CheckFinding]:
    stretches = stretches_of(recording)
    return check_stamps(recording, stretches), check_azimuths(stretches)


class Holed(SimulatedRecording):
    """A drive without its azimuths 20 to 24."""

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        for turn in super().polar_scans(start, stop):
            names = ("times", "azimuths", "power", "valid")
            yield replace(turn, **{name: np.delete(getattr(turn, name), np.arange(20, 25), axis=0) for name in names})


def spread(folder: Path, begins_us: list[int], *, turn_us: int = TURN_US, swept: float = 1.0) -> Recording:
    """Returns a recording of polar scans that begin at stamps after the start [us], each swept for part of a turn."""
    (folder / "radar").mkdir(parents=True)
    rows = np.arange(40)
    for k, begin in enumerate(begins_us):
        ticks = np.round(rows * 140 * swept).astype(np.int64)
        stamps = START_US + begin + rows * turn_us // 40
        write_png(folder, with_metadata(oxford_rows(k)[:, 11:], stamps, ticks, np.ones(40, bool)))
    return open_recording(folder)


def test_a_steady_recording_is_ok(oxford: Path) -> None:
    stamps, azimuths = findings(open_recording(oxford))
    assert (stamps.verdict, azimuths.verdict) == (CheckVerdict.OK, CheckVerdict.OK)
    assert "6 turns of 0.2500 s" in stamps.text and "40 in every turn" in azimuths.text


def test_gaps_are_counted(tmp_path: Path) -> None:
    stamps, _ = findings(open_recording(write_oxford(tmp_path / "d", polar_scans=20, skip=(4, 5, 12))))
    assert stamps.verdict is CheckVerdict.SUSPICIOUS and "followed by a gap, 0.75 s in all: 2" in stamps.text


@pytest.mark.parametrize(
    ("begins", "turn_us", "problem"),
    [
        ([*range(0, 2_000_000, TURN_US), 1_850_000], TURN_US, "that begin too soon after the previous one: 1"),
        ([0, 250_000, 500_000, 790_000, 1_000_000, 1_290_000, 1_500_000], 200_000, "a turn varies by 3"),
        (list(range(0, 2_000_000, TURN_US)), 2 * TURN_US, "that last into the next one: 7"),
        (list(range(0, 2_000_000, TURN_US)), TURN_US // 10, "with azimuth times that span less than the turn: 8"),
    ],
)
def test_turns_that_do_not_follow_one_another_are_named(
    tmp_path: Path, begins: list[int], turn_us: int, problem: str
) -> None:
    stamps, _ = findings(spread(tmp_path / "d", begins, turn_us=turn_us))
    assert stamps.verdict is CheckVerdict.SUSPICIOUS and problem in stamps.text


def test_a_polar_scan_that_comes_twice_is_noticed(oxford: Path) -> None:
    rows = np.arange(40)
    stamps = START_US + 3 * TURN_US + rows * TURN_US // 40
    write_png(oxford, with_metadata(oxford_rows(2)[:, 11:], stamps, 140 * rows, np.ones(40, bool)))
    stamps, _ = findings(open_recording(oxford))
    assert stamps.verdict is CheckVerdict.SUSPICIOUS and "equal to the previous one, byte by byte: 1" in stamps.text


def test_faults_that_the_reader_found_are_passed_on(oxford: Path) -> None:
    recording = open_recording(oxford)
    assert findings(recording)[0].verdict is CheckVerdict.OK
    stamps, _ = findings(replace(recording, faults=("the stamps of 2 messages repeat or run backward: left out",)))
    assert stamps.verdict is CheckVerdict.SUSPICIOUS and "2 messages repeat or run backward" in stamps.text


def test_polar_scans_that_cannot_be_read_are_named_and_the_others_looked_at(oxford: Path) -> None:
    image = oxford / "radar" / f"{START_US + 3 * TURN_US}.png"
    image.write_bytes(image.read_bytes()[:2000])
    stamps, azimuths = findings(open_recording(oxford))
    assert stamps.verdict is CheckVerdict.SUSPICIOUS
    assert f"a polar scan cannot be read: {image}: is not a readable PNG" in stamps.text
    assert azimuths.verdict is CheckVerdict.OK


def test_part_of_a_turn_and_holes_are_noticed(tmp_path: Path) -> None:
    _, azimuths = findings(spread(tmp_path / "d", list(range(0, 2_000_000, TURN_US)), swept=0.8))
    assert azimuths.verdict is CheckVerdict.SUSPICIOUS and "72.0 deg off a whole turn" in azimuths.text
    _, azimuths = findings(Holed(**{name: getattr(left_turn(), name) for name in left_turn().__dataclass_fields__}))
    assert azimuths.verdict is CheckVerdict.SUSPICIOUS and "holes of up to 54.0 deg between azimuths" in azimuths.text


def test_azimuths_that_were_not_measured_are_counted(tmp_path: Path) -> None:
    (tmp_path / "radar").mkdir()
    for k in range(4):
        rows = oxford_rows(k)
        rows[:5, 10] = 0
        write_png(tmp_path, rows)
    _, azimuths = findings(open_recording(tmp_path, format="oxford"))
    assert azimuths.verdict is CheckVerdict.SUSPICIOUS and "12% of the azimuths were not measured" in azimuths.text


def test_stretches_are_short_few_and_apart_and_lie_where_odometry_turns(tmp_path: Path) -> None:
    recording = open_recording(write_oxford(tmp_path / "d", polar_scans=80, skip=(60,)))
    spans = [[w.t0 for w in s.scans] for s in stretches_of(recording)]
    assert len(spans) == 3 and all(len(span) == 12 for span in spans)
    assert all(np.allclose(np.diff(span), 0.25) for span in spans)
    assert all(one[-1] < other[0] for one, other in itertools.pairwise(spans))
    turn = np.cumsum(np.where(np.arange(80) == 30, 0.5, 0.0))
    track = Trajectory(START_US + TURN_US * np.arange(80), np.column_stack([2.0 * np.arange(80), np.zeros(80), turn]))
    spans = [[w.t0 for w in s.scans] for s in stretches_of(recording, track)]
    assert any(span[0] < 29 * 0.25 < span[-1] for span in spans)


def test_where_gaps_leave_no_long_stretch_the_longest_is_looked_at(tmp_path: Path) -> None:
    for name, skip, expected in (
        ("ends", (11, 12, 13, 14), [range(0, 11)]),
        ("middle", (3, 9, 10), [range(4, 9)]),
        ("all", tuple(range(1, 16, 2)), [range(k, k + 1) for k in (2, 8, 12)]),
    ):
        recording = open_recording(write_oxford(tmp_path / name, polar_scans=16, skip=skip))
        stretches = stretches_of(recording)
        assert all(len(stretch.turns) == len(stretch.scans) == len(expected[0]) for stretch in stretches)
        if len(expected) == 1:
            assert [w.t0 / 0.25 for w in stretches[0].scans] == pytest.approx(list(expected[0]))
        stamps, azimuths = findings(recording)
        assert stamps.verdict is CheckVerdict.SUSPICIOUS and "followed by a gap" in stamps.text
        assert azimuths.verdict is CheckVerdict.OK


@pytest.mark.parametrize("skip", [(), (1, 2, 3)])
def test_one_and_two_polar_scans_say_what_they_cannot_tell(tmp_path: Path, skip: tuple[int, ...]) -> None:
    for polar_scans in (1, 5 if skip else 2):
        recording = open_recording(write_oxford(tmp_path / f"{polar_scans}", polar_scans=polar_scans, skip=skip))
        stretches = stretches_of(recording)
        stamps, azimuths = findings(recording)
        assert azimuths.verdict is CheckVerdict.OK
        assert "too few to show how steady turns are" in stamps.text or recording.gaps()
        order = check_order(follow(recording, stretches, CONFIG, BEAM))
        longest = 1 if skip else min(polar_scans, 2)
        assert order.verdict is CheckVerdict.UNTOLD
        needs = "the check needs 7 polar scans without a gap between them; the longest such stretch has"
        assert order.text == f"{needs} {longest}"


def test_polar_scans_that_are_swept_alike_in_both_orders_cannot_tell_the_order() -> None:
    same = np.full(9, 1.5)
    none = np.zeros(0, dtype=np.int64)
    finding = check_order(FollowedStretches(Steps(none, none, np.zeros((0, 3))), same, same, shortage=""))
    assert finding.verdict is CheckVerdict.UNTOLD and all(np.isfinite(value) for value in finding.numbers.values())


def test_a_radar_that_turns_faster_from_some_moment_on_is_only_called_unsteady(tmp_path: Path) -> None:
    takes = [500_000] * 12 + [200_000] * 20
    recording = spinning([0, *np.cumsum(takes[:-1]).tolist()], takes)
    back = open_recording(convert(recording, tmp_path, "oxford")[0])
    stamps, _ = findings(back)
    assert stamps.text == "the duration of a turn varies by 150%"


def test_few_short_stretches_are_too_few_to_tell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = open_recording(write_oxford(tmp_path / "d", polar_scans=20))
    monkeypatch.setattr("mqslam.check.stretches.STRETCHES", 2)
    monkeypatch.setattr("mqslam.check.stretches.STRETCH_SCANS", 5)
    monkeypatch.setattr("mqslam.check.checks._FEWEST_TURNS", 30)
    stretches = stretches_of(recording)
    assert [len(stretch.scans) for stretch in stretches] == [5, 5]
    assert "too few to show how steady turns are" in check_stamps(recording, stretches).text
