"""What the package writes is, file by file, what the descriptions of the layouts make of the same drive."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.conversions import convert
from support.layouts import left_turn, write_boreas, write_mulran_columns, write_mulran_rows, write_radiate


def images(root: Path) -> dict[str, np.ndarray]:
    """Returns the pixels of every image below a folder by its path."""
    return {str(path.relative_to(root)): np.array(Image.open(path)) for path in sorted(root.rglob("*.png"))}


def to_whole_us(name: str) -> str:
    """Returns a path whose file is named after a stamp in ns, cut to whole microseconds."""
    folder, _, stem = name.removesuffix(".png").rpartition("/")
    return f"{folder}/{int(stem) // 1000}"


def test_boreas_is_named_after_the_middles_and_holds_the_same_rows(tmp_path: Path) -> None:
    described, written = write_boreas(tmp_path / "described", left_turn()), convert(left_turn(), tmp_path, "boreas")[0]
    ours, theirs = images(written), images(described)
    assert ours.keys() == theirs.keys()
    for name, pixels in theirs.items():
        np.testing.assert_array_equal(ours[name], pixels)
    columns = [(root / "applanix" / "radar_poses.csv").read_text().splitlines()[0] for root in (described, written)]
    assert columns[0] == columns[1]
    poses = np.loadtxt(written / "applanix" / "radar_poses.csv", delimiter=",", skiprows=1)
    middle = poses[len(poses) // 2]
    assert np.hypot(middle[4], middle[5]) == pytest.approx(8.0, rel=0.01) and middle[10] == pytest.approx(-0.4, rel=0.01)


def test_mulran_columns_are_named_after_the_ends(tmp_path: Path) -> None:
    described = write_mulran_columns(tmp_path / "described", left_turn())
    ours, theirs = images(convert(left_turn(), tmp_path, "mulran")[0]), images(described)
    assert [to_whole_us(name) for name in ours] == [to_whole_us(name) for name in theirs]
    for one, other in zip(ours.values(), theirs.values(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_mulran_rows_are_stamped_in_nanoseconds(tmp_path: Path) -> None:
    described = write_mulran_rows(tmp_path / "described", left_turn())
    ours, theirs = images(convert(left_turn(), tmp_path, "mulran_oxford")[0]), images(described)
    assert [to_whole_us(name) for name in ours] == [to_whole_us(name) for name in theirs]
    for one, other in zip(ours.values(), theirs.values(), strict=True):
        np.testing.assert_array_equal(one[:, 8:], other[:, 8:])
        stamps = [np.ascontiguousarray(rows[:, :8]).view("<i8") // 1000 for rows in (one, other)]
        np.testing.assert_array_equal(*stamps)


def test_radiate_numbers_its_images_and_lists_their_arrival(tmp_path: Path) -> None:
    described, written = write_radiate(tmp_path / "described", left_turn()), convert(left_turn(), tmp_path, "radiate")[0]
    ours, theirs = images(written), images(described)
    assert ours.keys() == theirs.keys()
    for name, pixels in theirs.items():
        np.testing.assert_array_equal(ours[name], pixels)
    lists = [(root / "Navtech_Polar.txt").read_text().splitlines() for root in (described, written)]
    assert [line[:-3] for line in lists[0]] == [line[:-3] for line in lists[1]]
