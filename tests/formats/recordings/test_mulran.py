from __future__ import annotations

import pickle
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.layouts import (
    NS,
    assert_alike,
    assert_turns_left,
    ends,
    left_turn,
    write_mulran_columns,
    write_mulran_poses,
    write_mulran_rows,
)
from support.recordings import assert_same

from mqslam.errors import DataError
from mqslam.formats.recordings import open_recording
from mqslam.simulator import SimulatedRecording


@pytest.fixture
def columns(tmp_path: Path) -> Path:
    return write_mulran_columns(tmp_path / "KAIST03", left_turn())


def images_of(root: Path) -> list[Path]:
    return sorted(root.rglob("*.png"))


def test_polar_images_are_the_drive_spread_over_turns_that_end_at_their_names(columns: Path) -> None:
    recording = open_recording(columns)
    assert (recording.format, recording.range_resolution) == ("mulran", 0.0595)
    assert_alike(recording, left_turn())
    assumed, note = recording.notes
    assert recording.is_resolution_assumed
    assert assumed.startswith("range resolution 0.0595 m is assumed, as MulRan's radar has it")
    assert note.startswith("azimuths carry no stamps of their own and are spread evenly over the turn; ")
    assert "file stamps are taken as the end" in note
    assert_same(recording, pickle.loads(pickle.dumps(recording)))


@pytest.mark.parametrize("inside", ["sensor_data/radar", "radar", "."])
def test_oxford_rows_are_the_drive_by_their_own_stamps(tmp_path: Path, inside: str) -> None:
    recording = open_recording(write_mulran_rows(tmp_path / "KAIST03", left_turn(), inside))
    assert (recording.format, recording.range_resolution) == ("mulran", 0.0595)
    assert recording.is_resolution_assumed and len(recording.notes) == 1
    assert_alike(recording, left_turn())


def test_rows_with_own_stamps_go_before_columns_without(columns: Path) -> None:
    write_mulran_rows(columns, left_turn())
    assert len(open_recording(columns).notes) == 1  # that the length of a range bin is assumed


@pytest.mark.parametrize("inside", [".", "sensor_data/radar", "sensor_data/radar/polar"])
def test_every_folder_down_to_the_images_opens_the_same_recording(columns: Path, inside: str) -> None:
    write_mulran_poses(columns, left_turn())
    recording = open_recording(columns / inside)
    assert_same(open_recording(columns), recording)
    assert recording.ground_truth is not None


@pytest.mark.parametrize("write", [write_mulran_columns, write_mulran_rows])
def test_poses_of_the_vehicle_become_poses_of_the_radar(
    tmp_path: Path, write: Callable[[Path, SimulatedRecording], Path]
) -> None:
    root = write(tmp_path / "DCC01", left_turn())
    write_mulran_poses(root, left_turn())
    truth = open_recording(root).ground_truth
    assert_turns_left(truth, left_turn(), left_turn().start_us + np.arange(0, 1_500_001, 100_000))


def test_a_pose_that_comes_twice_is_taken_once(columns: Path) -> None:
    write_mulran_poses(columns, left_turn())
    poses = columns / "global_pose.csv"
    lines = poses.read_text().splitlines()
    poses.write_text("\n".join([*lines, lines[3]]))
    truth = open_recording(columns).ground_truth
    assert truth is not None and len(truth) == len(lines)


def test_the_mount_is_said_to_be_the_published_one(columns: Path) -> None:
    mount = open_recording(columns).mount
    assert mount is not None and mount.source.startswith("the calibration that MulRan publishes")


@pytest.mark.parametrize("line", ["1600000000000000417,1,2", "1600000000000000417" + ",nan" * 12, "t,1,2,3"])
def test_broken_poses_are_left_out_by_name(columns: Path, line: str) -> None:
    write_mulran_poses(columns, left_turn())
    poses = columns / "global_pose.csv"
    poses.write_text(poses.read_text() + line + "\n")
    recording = open_recording(columns)
    assert recording.ground_truth is None and len(recording) == 6
    (fault,) = recording.faults
    assert re.fullmatch(
        rf"{poses} (row \d+ is not made of finite numbers|holds stamps that are no numbers): left out", fault
    )


def test_names_of_19_digits_are_kept_exactly(columns: Path) -> None:
    assert [image.stem for image in images_of(columns)] == [str(end * 1000 + NS) for end in ends(left_turn())]
    (last,) = open_recording(columns).polar_scans(5)
    np.testing.assert_array_equal(last.power, left_turn()[5].power)


def test_a_gap_does_not_stretch_the_turn_after_it(columns: Path) -> None:
    for image in images_of(columns)[2:4]:
        image.unlink()
    recording = open_recording(columns)
    np.testing.assert_allclose(recording.stamps_us, left_turn().stamps_us[[0, 1, 4, 5]], rtol=0.0, atol=1)
    assert recording.gaps() == [(1, pytest.approx(0.5, abs=1e-5))]
    assert all(np.ptp(polar_scan.times) < 0.25 for polar_scan in recording.polar_scans())


def test_one_image_is_a_recording_at_4_turns_a_second(columns: Path) -> None:
    for image in images_of(columns)[1:]:
        image.unlink()
    recording = open_recording(columns)
    assert len(recording) == 1 and recording.revolution_s == pytest.approx(0.25)


def test_a_truncated_image_in_the_middle_is_named(columns: Path) -> None:
    image = images_of(columns)[3]
    image.write_bytes(image.read_bytes()[:400])
    recording = open_recording(columns)
    assert len(list(recording.polar_scans(0, 3))) == 3
    with pytest.raises(DataError, match=rf"{image.name}: is not a readable PNG"):
        list(recording.polar_scans())


def test_an_image_of_another_shape_is_named(columns: Path) -> None:
    image = images_of(columns)[3]
    Image.fromarray(np.zeros((100, 40), np.uint8)).save(image)
    with pytest.raises(DataError, match=rf"{image.name}: holds 100 ranges by 40 azimuths, the first image 200 ranges by 40"):
        list(open_recording(columns).polar_scans())


def test_images_that_lie_on_their_side_are_named(columns: Path) -> None:
    for image, polar_scan in zip(images_of(columns), left_turn().polar_scans(), strict=True):
        Image.fromarray(polar_scan.power).save(image)
    with pytest.raises(DataError, match=rf"{images_of(columns)[0].name}: holds 40 rows by 200 columns"):
        open_recording(columns)


def test_a_folder_without_images_is_named_when_the_format_is(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(DataError, match="holds no radar images of MulRan"):
        open_recording(tmp_path, format="mulran")
