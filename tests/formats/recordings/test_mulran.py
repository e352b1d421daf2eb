from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
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


@pytest.mark.parametrize("inside", ["sensor_data/radar", "radar", "."])
def test_oxford_rows_are_the_drive_by_their_own_stamps(tmp_path: Path, inside: str) -> None:
    recording = open_recording(write_mulran_rows(tmp_path / "KAIST03", left_turn(), inside))
    assert (recording.format, recording.range_resolution) == ("mulran", 0.0595)
    assert recording.is_resolution_assumed and len(recording.notes) == 1
    assert_alike(recording, left_turn())


def test_rows_with_own_stamps_go_before_columns_without(columns: Path) -> None:
    write_mulran_rows(columns, left_turn())
    assert len(open_recording(columns).notes) == 1  # that the length of a range bin is assumed


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
