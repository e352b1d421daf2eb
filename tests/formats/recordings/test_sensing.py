"""What a user says about a radar reaches the reader where the recording does not say it, and is idle elsewhere."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.commands import mqslam
from support.layouts import (
    left_turn,
    write_boreas,
    write_mulran_columns,
    write_mulran_rows,
    write_player_bag,
    write_radiate,
)
from support.recordings import write_bag

from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.native import write as write_native
from mqslam.formats.recordings.turns import find_usual_turns, place_turns
from mqslam.simulator import SimulatedRecording

Writer = Callable[[Path, SimulatedRecording], Path]
WITHOUT_STAMPS = [write_mulran_columns, write_radiate, write_player_bag]


@pytest.mark.parametrize("write", WITHOUT_STAMPS)
def test_stamps_of_the_start_shift_the_turns_by_one(tmp_path: Path, write: Writer) -> None:
    root = write(tmp_path / "drive", left_turn())
    by_end, by_start = open_recording(root, stamp="end"), open_recording(root, stamp="start")
    np.testing.assert_array_equal(open_recording(root).stamps_us, by_end.stamps_us)
    np.testing.assert_array_equal(by_start.stamps_us[:-1], by_end.stamps_us[1:])
    np.testing.assert_array_equal(by_start[2].power, by_end[2].power)
    assert any("taken as the start of the turn" in note for note in by_start.notes)


@pytest.mark.parametrize("write", WITHOUT_STAMPS)
def test_a_radar_that_turns_the_other_way_sees_the_mirror_image(tmp_path: Path, write: Writer) -> None:
    root = write(tmp_path / "drive", left_turn())
    usual, mirrored = open_recording(root), open_recording(root, clockwise=False)
    np.testing.assert_allclose(mirrored[1].azimuths, -usual[1].azimuths)
    np.testing.assert_array_equal(mirrored[1].times, usual[1].times)
    assert any("azimuths as counter-clockwise" in note for note in mirrored.notes)


def test_azimuths_with_angles_and_stamps_of_their_own_are_mirrored_as_told_and_leave_the_instant_idle(
    oxford: Path, tmp_path: Path
) -> None:
    native = tmp_path / "drive.npz"
    write_native(native, open_recording(oxford))
    bag = write_bag(open_recording(oxford), tmp_path / "drive.bag", "ros1")
    folders = [write_boreas(tmp_path / "b", left_turn()), write_mulran_rows(tmp_path / "m", left_turn())]
    folders += [oxford, native, bag]
    for folder in folders:
        plain, told = open_recording(folder), open_recording(folder, clockwise=False, stamp="end")
        np.testing.assert_array_equal(plain.stamps_us, told.stamps_us)
        for one, other in zip(plain.polar_scans(), told.polar_scans(), strict=True):
            np.testing.assert_array_equal(one.azimuths, -other.azimuths)
            np.testing.assert_array_equal(one.power, other.power)
        said = [note for note in told.notes if "sensor." in note and note not in plain.notes]
        assert sorted(note.split("sensor.")[1] for note in said) == [
            "clockwise), against the order of its azimuths: the scans are mirrored",
            "stamp has no effect",
        ]
        assert open_recording(folder, clockwise=True).notes == plain.notes


def test_settings_reach_the_reader_and_info_shows_what_was_assumed(tmp_path: Path) -> None:
    root = write_radiate(tmp_path / "city_1_0", left_turn())
    (tmp_path / "mine.yaml").write_text("sensor: {clockwise: false, stamp: start, range_resolution_m: 0.2}\n")
    shown = mqslam("info", root, "--config", tmp_path / "mine.yaml", "--json")
    assert shown.code == 0
    facts = json.loads(shown.out)
    assert facts["range_resolution_m"] == 0.2
    assert any("start of the turn" in note and "counter-clockwise" in note for note in facts["notes"])
    assert "spread evenly over the turn" in mqslam("info", root).out


def test_a_setting_that_is_no_convention_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("sensor: {stamp: middle}\n")
    shown = mqslam("info", tmp_path, "--config", tmp_path / "mine.yaml")
    assert shown.code == 2 and "sensor.stamp: must be 'start' or 'end'" in shown.err


def test_turns_follow_their_stamps_and_stop_at_gaps() -> None:
    stamps = 1000 * np.array([1000, 1100, 1190, 2000, 2105])
    starts, durations = place_turns(stamps, "start", find_usual_turns(stamps))
    np.testing.assert_array_equal(starts, stamps)
    np.testing.assert_array_equal(durations, [100_000, 90_000, 105_000, 105_000, 105_000])
    starts, durations = place_turns(stamps, "end", find_usual_turns(stamps))
    np.testing.assert_array_equal(durations, [100_000, 100_000, 90_000, 105_000, 105_000])
    np.testing.assert_array_equal(starts, stamps - durations)
    assert np.all(starts[1:] >= stamps[:-1])
