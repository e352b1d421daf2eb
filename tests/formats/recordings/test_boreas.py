from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.layouts import assert_alike, assert_turns_left, left_turn, write_boreas
from support.recordings import oxford_rows, with_metadata, write_oxford, write_png

from mqslam.errors import DataError
from mqslam.formats.conversion import write_recording
from mqslam.formats.recordings import list_targets, open_recording
from mqslam.formats.recordings.boreas import UPGRADE_US

AZIMUTHS = left_turn().sensor.azimuths


@pytest.fixture
def boreas(tmp_path: Path) -> Path:
    return write_boreas(tmp_path / "boreas-2020", left_turn())


def note_of(folder: Path, word: str) -> str:
    return next((note for note in open_recording(folder).notes if word in note), "")


def test_a_drive_in_boreas_layout_is_the_drive(boreas: Path) -> None:
    recording = open_recording(boreas)
    assert recording.format == "boreas" and recording.is_resolution_assumed
    bins, offset = recording.notes
    assert bins.startswith("range resolution 0.0596 m is assumed, as Boreas's radar at that date has it")
    assert offset.startswith("a range offset of -0.31 m is assumed")
    stated = open_recording(recording.path, range_resolution=0.06, range_offset=0.0)
    assert not stated.notes and not stated.is_resolution_assumed
    assert_alike(recording, left_turn())


def test_the_range_offset_counts_from_the_near_end_of_a_bin(boreas: Path) -> None:
    assert open_recording(boreas).range_offset == pytest.approx(-0.31 - 0.5 * 0.0596)
    (boreas / "calib").mkdir()
    stated = boreas / "calib" / "misc_calibrations.yaml"
    stated.write_text("wheel_radius: 0.34\nradar_offset: -0.2\nradar_doppler_beta: 0.049\n")
    recording = open_recording(boreas, range_resolution=0.06)
    assert recording.range_offset == pytest.approx(-0.23) and not recording.notes
    assert open_recording(boreas, range_offset=0.1).range_offset == 0.1
    stated.write_text("wheel_radius: 0.34\n")
    assert open_recording(boreas, range_resolution=0.06).range_offset == pytest.approx(-0.34)
    assert note_of(boreas, "range offset").startswith("a range offset of -0.31 m is assumed")
    for text in (
        "radar_offset: near",
        "radar_offset: .nan",
        "radar_offset: 30",
        "- 1",
        "radar_offset: [1",
        "radar_offset: null",
    ):
        stated.write_text(text)
        with pytest.raises(DataError, match=r"misc_calibrations.yaml: states no radar_offset that fits a radar"):
            open_recording(boreas)


def test_poses_are_those_of_the_middle_of_the_turns_in_rep_103(boreas: Path) -> None:
    names = np.array(sorted(int(image.stem) for image in (boreas / "radar").iterdir()))
    assert_turns_left(open_recording(boreas).ground_truth, left_turn(), names)
    assert np.all(names - left_turn().stamps_us == left_turn().azimuth_stamps(0)[AZIMUTHS // 2 - 1] - left_turn().start_us)


def test_poses_stamped_in_ns_are_read_exactly(boreas: Path) -> None:
    poses = boreas / "applanix" / "radar_poses.csv"
    in_us = open_recording(boreas).ground_truth
    header, *lines = poses.read_text().splitlines()
    poses.write_text("\n".join([header, *(line.replace(",", "787,", 1) for line in lines)]))
    in_ns = open_recording(boreas).ground_truth
    assert in_us is not None and in_ns is not None
    np.testing.assert_allclose(in_ns.stamps_us - in_us.stamps_us, 0, atol=1)


def test_a_recording_without_poses_has_no_ground_truth(boreas: Path) -> None:
    (boreas / "calib").mkdir()
    (boreas / "applanix" / "radar_poses.csv").unlink()
    recording = open_recording(boreas)
    assert recording.format == "boreas" and recording.ground_truth is None


def test_without_its_other_folders_it_is_read_as_oxford_all_the_same(boreas: Path) -> None:
    (boreas / "applanix").rename(boreas.parent / "applanix")
    recording = open_recording(boreas)
    assert recording.format == "oxford"
    assert_alike(recording, left_turn())


@pytest.mark.parametrize(("begin_us", "expected"), [(UPGRADE_US - 10_000_000, 0.0596), (UPGRADE_US, 0.04381)])
def test_the_length_of_a_bin_goes_by_the_date(tmp_path: Path, begin_us: int, expected: float) -> None:
    folder = tmp_path / "drive"
    for name in ("radar", "calib"):
        (folder / name).mkdir(parents=True)
    rows = np.arange(40)
    for k in range(2):
        stamps = begin_us + k * 250_000 + rows * 6250
        write_png(folder, with_metadata(oxford_rows(k)[:, 11:], stamps, rows * 140, np.ones(40, bool)))
    assert open_recording(folder).range_resolution == expected
    assert open_recording(folder, range_resolution=0.06).range_resolution == 0.06


def test_of_alternating_chirps_the_rising_ones_are_kept(tmp_path: Path) -> None:
    up = np.arange(AZIMUTHS) % 2 == 1
    folder = write_boreas(tmp_path / "rt", left_turn(), up)
    recording = open_recording(folder)
    assert "50% of the rows and is taken as the direction of the chirp" in note_of(folder, "byte 10")
    for kept, whole in zip(recording.polar_scans(), left_turn().polar_scans(), strict=True):
        assert kept.valid.all()
        np.testing.assert_array_equal(kept.power, whole.power[up])
        np.testing.assert_allclose(kept.azimuths, whole.azimuths[up])
        np.testing.assert_allclose(np.diff(kept.times), np.diff(whole.times[up]), atol=1.1e-6)
    into = recording[3].times - recording.start_times[3]
    np.testing.assert_allclose(into, left_turn()[3].times[up] - 0.75 - 0.00625, atol=2e-6)


def test_a_conversion_keeps_falling_chirps_or_says_that_they_are_left_behind(tmp_path: Path) -> None:
    recording = open_recording(write_boreas(tmp_path / "rt", left_turn(), np.arange(AZIMUTHS) % 2 == 1))
    for number, target in enumerate(list_targets()):
        out = tmp_path / f"drive{number}{target.suffix}"
        notes = write_recording(recording, out, target, lambda done, total: None)
        kept = open_recording(out)[0].down is not None
        assert any(note.startswith("down-chirps are left behind") for note in notes) != kept
        assert kept == (target.name in ("oxford", "boreas"))


def test_falling_chirps_only_or_an_unused_byte_are_all_kept(tmp_path: Path) -> None:
    folder = write_boreas(tmp_path / "rt", left_turn(), np.zeros(AZIMUTHS, bool))
    assert "0% of the rows and is taken as unused or as down-chirps" in note_of(folder, "byte 10")
    assert_alike(open_recording(folder), left_turn())


def test_a_few_unmarked_rows_were_not_measured(tmp_path: Path) -> None:
    measured = np.arange(AZIMUTHS) != 7
    recording = open_recording(write_boreas(tmp_path / "drive", left_turn(), measured))
    assert len(recording.notes) == 2  # that the length of a range bin and the range offset are assumed
    np.testing.assert_array_equal(recording[2].valid, measured)


def test_a_polar_scan_without_rising_chirps_is_named(tmp_path: Path) -> None:
    folder = write_boreas(tmp_path / "rt", left_turn(), np.arange(AZIMUTHS) % 2 == 1)
    image = sorted((folder / "radar").iterdir())[2]
    falling = with_metadata(
        left_turn()[2].power, left_turn().azimuth_stamps(2), left_turn().sensor.encoders, np.zeros(AZIMUTHS, bool)
    )
    write_png(folder, falling)
    (folder / "radar" / f"{left_turn().azimuth_stamps(2)[0]}.png").rename(image)
    with pytest.raises(DataError, match=rf"{image.name}: has 0 up-chirps"):
        list(open_recording(folder).polar_scans())


def test_polar_scans_begin_where_their_own_turns_did_even_if_the_motor_drifts(tmp_path: Path) -> None:
    folder = tmp_path / "drive"
    for name in ("radar", "calib"):
        (folder / name).mkdir(parents=True)
    begin, begins = left_turn().start_us, []
    for k in range(20):
        turn = 250_000 + 200 * k
        stamps = begin + np.arange(40) * turn // 40
        write_png(folder, with_metadata(oxford_rows(k)[:, 11:], stamps, np.arange(40) * 140, np.ones(40, bool)))
        (folder / "radar" / f"{begin}.png").rename(folder / "radar" / f"{stamps[19]}.png")
        begins.append(begin)
        begin += turn
    np.testing.assert_allclose(open_recording(folder).stamps_us - begins, 0, atol=120)


def test_only_the_first_and_the_last_image_are_read_to_open(boreas: Path) -> None:
    images = sorted((boreas / "radar").iterdir())
    for image in images[1:-1]:
        image.write_bytes(image.read_bytes()[:300])
    recording = open_recording(boreas)
    assert len(recording) == 6
    with pytest.raises(DataError, match=rf"{images[1].name}: is not a readable PNG"):
        list(recording.polar_scans())


def test_an_oxford_folder_stays_oxford(tmp_path: Path) -> None:
    assert open_recording(write_oxford(tmp_path / "drive")).format == "oxford"


def test_images_without_metadata_are_named(tmp_path: Path) -> None:
    folder = write_oxford(tmp_path / "drive", polar_scans=1)
    (folder / "applanix").mkdir()
    write_png(folder, oxford_rows(0)[:, :11])
    with pytest.raises(DataError, match=r"\d+\.png: has rows of 11 bytes"):
        open_recording(folder)
