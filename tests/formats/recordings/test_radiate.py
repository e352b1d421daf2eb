from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from support.conversions import spinning
from support.layouts import assert_alike, left_turn, write_radiate
from support.sensors import write_radiate_messages

from mqslam.errors import DataError
from mqslam.formats.recordings import open_recording


@pytest.fixture
def radiate(tmp_path: Path) -> Path:
    return write_radiate(tmp_path / "city_1_0", left_turn())


def edit(listing: Path, number: int, line: str) -> None:
    lines = listing.read_text().splitlines()
    lines[number - 1] = line
    listing.write_text("\n".join(line for line in lines if line) + "\n")


def test_images_are_the_drive_spread_over_turns_that_end_at_their_arrival(radiate: Path) -> None:
    recording = open_recording(radiate)
    assert recording.format == "radiate"
    assert recording.range_resolution == pytest.approx(0.175)
    assert_alike(recording, left_turn())
    assert recording.odometry is None and recording.ground_truth is None


def test_what_was_assumed_is_said(radiate: Path) -> None:
    notes = open_recording(radiate).notes
    assert any(note.startswith("azimuths carry no stamps of their own and are spread evenly") for note in notes)
    assert not any(note.startswith("GPS and IMU run on another clock") for note in notes)


@pytest.mark.parametrize("place", ["", "Navtech_Polar"])
@pytest.mark.parametrize("name", ["Navtech_Polar.txt", "GPS_IMU_Twist.txt"])
def test_a_link_out_of_the_recording_is_refused_whichever_folder_is_named(
    radiate: Path, tmp_path: Path, place: str, name: str
) -> None:
    write_radiate_messages(radiate)
    (radiate / name).rename(tmp_path / "elsewhere")
    (radiate / name).symlink_to(tmp_path / "elsewhere")
    if name == "Navtech_Polar.txt":
        with pytest.raises(DataError, match=r"Navtech_Polar\.txt: is a link out of the recording"):
            open_recording(radiate / place)
    else:
        (fault,) = open_recording(radiate / place).faults
        assert "GPS_IMU_Twist.txt is a link out of the recording" in fault


def test_frames_without_an_image_are_skipped_and_noted(radiate: Path) -> None:
    (radiate / "Navtech_Polar" / "000003.png").unlink()
    recording = open_recording(radiate)
    np.testing.assert_allclose(recording.stamps_us, left_turn().stamps_us[[0, 1, 3, 4, 5]], rtol=0.0, atol=1)
    assert any("1 of 6 frames in Navtech_Polar.txt have no image and are skipped" in note for note in recording.notes)
    np.testing.assert_array_equal(recording[2].power, left_turn()[3].power)


@pytest.mark.parametrize("line", ["Frame: 000003", "Frame: 000003 Time: soon"])
def test_a_broken_list_of_stamps_is_named(radiate: Path, line: str) -> None:
    edit(radiate / "Navtech_Polar.txt", 3, line)
    with pytest.raises(DataError, match=r"Navtech_Polar\.txt: line 3 is not 'Frame: 000001 Time: "):
        open_recording(radiate)


def test_a_missing_or_empty_list_of_stamps_is_named(radiate: Path) -> None:
    listing = radiate / "Navtech_Polar.txt"
    listing.write_text("")
    with pytest.raises(DataError, match=r"Navtech_Polar\.txt: is empty; it should hold a line"):
        open_recording(radiate)
    listing.unlink()
    with pytest.raises(DataError, match=r"Navtech_Polar\.txt: does not exist; it should hold a line"):
        open_recording(radiate)


@pytest.mark.parametrize("line", ["", "Frame: 000002 Time: 1700000000.3"])
def test_a_frame_without_a_stamp_in_order_is_left_out_and_said(radiate: Path, line: str) -> None:
    edit(radiate / "Navtech_Polar.txt", 3, line)
    recording = open_recording(radiate)
    assert len(list(recording.polar_scans())) == 5
    assert "Navtech_Polar.txt has no line for frame 000003: left out" in recording.faults
    edit(radiate / "Navtech_Polar.txt", 4, line)
    assert "Navtech_Polar.txt has no line for frame 000003 and 1 other: left out" in open_recording(radiate).faults


def test_nanoseconds_are_read_without_their_leading_zeros(tmp_path: Path) -> None:
    drive = write_radiate(tmp_path / "city_1_0", spinning([250_000 * k - 190_000 for k in range(40)], 250_000))
    expected = open_recording(drive)
    file = drive / "Navtech_Polar.txt"
    text, count = re.subn(r"\.0+(?=\d)", ".", file.read_text())
    file.write_text(text)
    recording = open_recording(drive)
    assert count >= 5 and recording.faults == ()
    np.testing.assert_array_equal(recording.stamps_us, expected.stamps_us)


def test_the_stamp_of_a_frame_that_arrives_after_the_next_one_is_put_back(radiate: Path) -> None:
    listing = radiate / "Navtech_Polar.txt"
    lines = listing.read_text().splitlines()
    edit(listing, 3, f"Frame: 000003 {lines[3].split(' ', 2)[2]}")
    recording = open_recording(radiate)
    np.testing.assert_allclose(recording.stamps_us, left_turn().stamps_us, rtol=0.0, atol=1)
    assert recording.faults == () and any("jitter" in note for note in recording.notes)


def test_a_damaged_stamp_is_said_and_costs_no_frame(radiate: Path) -> None:
    edit(radiate / "Navtech_Polar.txt", 3, "Frame: 000003 Time: 1234567890.1")
    recording = open_recording(radiate)
    np.testing.assert_allclose(recording.stamps_us, left_turn().stamps_us, rtol=0.0, atol=1)
    assert recording.faults[0].startswith("the stamp of polar scan number 3 among 6 lies too far")


def test_a_list_in_another_order_is_sorted_and_said(radiate: Path) -> None:
    expected = open_recording(radiate)
    file = radiate / "Navtech_Polar.txt"
    file.write_text("\n".join(reversed(file.read_text().splitlines())))
    recording = open_recording(radiate)
    assert recording.stamps_us.tolist() == expected.stamps_us.tolist()
    assert recording.images.names.tolist() == expected.images.names.tolist()
    assert recording.faults == ("Navtech_Polar.txt does not list its frames in order, first at 000005: they are sorted",)
