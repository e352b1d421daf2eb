"""What every layout of images must do: open from its inner folder, travel to workers, and name what is damaged."""

from __future__ import annotations

import pickle
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.layouts import (
    left_turn,
    write_boreas,
    write_mulran_columns,
    write_mulran_poses,
    write_mulran_rows,
    write_radiate,
)
from support.recordings import assert_same, write_oxford

from mqslam.errors import DataError
from mqslam.formats.recordings import open_recording

LAYOUTS: dict[str, tuple[Callable[[Path], Path], tuple[str, ...]]] = {
    "oxford": (write_oxford, ("radar",)),
    "boreas": (lambda folder: write_boreas(folder, left_turn()), ("radar",)),
    "mulran columns": (
        lambda folder: write_mulran_columns(folder, left_turn()),
        ("sensor_data/radar", "sensor_data/radar/polar"),
    ),
    "mulran rows": (
        lambda folder: write_mulran_rows(folder, left_turn()),
        ("sensor_data/radar", "sensor_data/radar/polar_oxford_form"),
    ),
    "radiate": (lambda folder: write_radiate(folder, left_turn()), ("Navtech_Polar",)),
}
"""How six polar scans are written in each layout, and the folders in it that open it, too; images lie in the last one."""
COLUMNS = ("mulran columns", "radiate")


@pytest.fixture(params=LAYOUTS)
def layout(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def drive(layout: str, tmp_path: Path) -> Path:
    return LAYOUTS[layout][0](tmp_path / "drive")


@pytest.fixture
def images(layout: str, drive: Path) -> list[Path]:
    return sorted((drive / LAYOUTS[layout][1][-1]).glob("*.png"))


def test_every_folder_down_to_the_images_opens_the_same_recording(
    layout: str, drive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = open_recording(drive)
    for inside in LAYOUTS[layout][1]:
        assert_same(whole, open_recording(drive / inside))
    monkeypatch.chdir(drive / LAYOUTS[layout][1][-1])
    assert_same(whole, open_recording(Path()))


def test_a_recording_survives_pickling(drive: Path) -> None:
    recording = open_recording(drive)
    assert_same(recording, pickle.loads(pickle.dumps(recording)))


def test_a_truncated_image_in_the_middle_is_named_once_it_is_read(layout: str, drive: Path, images: list[Path]) -> None:
    images[3].write_bytes(images[3].read_bytes()[:400])
    recording = open_recording(drive)
    assert len(recording) == 6
    # azimuths that were lost are sought in the images before and after, as far as these can be read
    assert len(list(recording.polar_scans(0, 3))) == 3
    with pytest.raises(DataError, match=rf"{images[3].name}: is not a readable PNG"):
        list(recording.polar_scans())


def test_one_image_is_a_recording_at_4_turns_a_second(drive: Path, images: list[Path]) -> None:
    for image in images[1:]:
        image.unlink()
    recording = open_recording(drive)
    assert len(recording) == 1 and recording.revolution_s == pytest.approx(0.25, abs=1e-5)


def test_a_folder_without_images_is_no_recording(layout: str, drive: Path, images: list[Path]) -> None:
    for image in images:
        image.unlink()
    with pytest.raises(DataError, match=r"holds no polar scans|holds no radar images of MulRan"):
        open_recording(drive, format=layout.split()[0])


@pytest.mark.parametrize("layout", COLUMNS)
@pytest.mark.parametrize("shape", [(199, 40), (100, 40), (40, 200), (200, 41)])
def test_a_polar_image_of_another_shape_is_named(drive: Path, images: list[Path], shape: tuple[int, int]) -> None:
    Image.fromarray(np.zeros(shape, np.uint8)).save(images[3])
    sizes = f"{shape[0]} ranges by {shape[1]} azimuths, the first image 200 ranges by 40"
    with pytest.raises(DataError, match=rf"{images[3].name}: holds {sizes}"):
        list(open_recording(drive).polar_scans())


@pytest.mark.parametrize("layout", COLUMNS)
def test_polar_images_that_lie_on_their_side_are_named(drive: Path, images: list[Path]) -> None:
    for image, polar_scan in zip(images, left_turn().polar_scans(), strict=True):
        Image.fromarray(polar_scan.power).save(image)
    with pytest.raises(DataError, match=rf"{images[0].name}: holds 40 rows by 200 columns"):
        open_recording(drive)


@pytest.mark.parametrize(("layout", "name"), [("boreas", "applanix/radar_poses.csv"), ("mulran columns", "global_pose.csv")])
@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("1600000000000000417,1,2", r"row \d+ is not made of finite numbers"),
        ("1600000000000000417" + ",nan" * 12, r"row \d+ is not made of finite numbers"),
        ("1600000000000000417,1,2,3,4,5,6,7,x,x,1,1,1", r"row \d+ is not made of finite numbers"),
        ("soon,1", "holds stamps that are no numbers"),
    ],
)
def test_broken_poses_are_left_out_by_name(layout: str, drive: Path, name: str, line: str, problem: str) -> None:
    if layout != "boreas":
        write_mulran_poses(drive, left_turn())
    poses = drive / name
    poses.write_text(poses.read_text() + line + "\n")
    recording = open_recording(drive)
    assert recording.ground_truth is None and len(recording) == 6
    (fault,) = recording.faults
    assert re.fullmatch(f"{poses} {problem}: left out", fault)
