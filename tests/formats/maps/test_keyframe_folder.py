"""A map of keyframes comes back from its folder as it was, and a damaged folder says which file is damaged."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.keyframe_maps import two_recordings

from mqslam.core.keyframes import KeyframeMap, PlaceTable
from mqslam.errors import DataError, OutputError
from mqslam.formats.maps.keyframe_folder import find_keyframes, read_keyframes, write_keyframes

MAPPED = asdict(two_recordings().keyframes.recordings[0])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A map of two recordings, within a result."""
    (tmp_path / "result").mkdir()
    write_keyframes(tmp_path / "result" / "keyframes", two_recordings())
    return tmp_path / "result" / "keyframes"


def assert_same(read: KeyframeMap, made: KeyframeMap) -> None:
    """Checks that two maps hold the same."""
    for field in fields(made.keyframes):
        a, b = (getattr(which.keyframes, field.name) for which in (read, made))
        if field.name == "georeference":
            assert (a is None) == (b is None) and (a is None or (a.plane, a.pose.tolist()) == (b.plane, b.pose.tolist()))
        elif field.name == "recordings":
            assert a == b
        else:
            np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(read.places.keyframes, made.places.keyframes)
    np.testing.assert_array_equal(read.places.descriptors, made.places.descriptors)
    assert read.places.made_with == made.places.made_with


def test_a_map_comes_back_as_it_was(folder: Path) -> None:
    for path in (folder, folder.parent):  # also by the result that holds it
        assert_same(read_keyframes(path), two_recordings())


def test_a_map_that_is_nowhere_on_the_earth_and_has_no_place_comes_back(tmp_path: Path) -> None:
    made = two_recordings().place_on_earth(None)
    made = replace(made, places=PlaceTable(np.empty(0, np.int64), np.empty((0, 4, 6), np.float16), {}))
    write_keyframes(tmp_path / "map", made)
    assert_same(read_keyframes(tmp_path / "map"), made)


def test_points_and_descriptors_stay_on_disk_until_they_are_asked_for(folder: Path) -> None:
    read = read_keyframes(folder)
    assert isinstance(read.keyframes.points, np.memmap) and isinstance(read.places.descriptors, np.memmap)


def test_the_same_map_makes_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    write_keyframes(tmp_path / "again", two_recordings())
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["descriptors.npy", "index.json", "keyframes.npy", "places.npy", "points.npy"]
    assert all((folder / name).read_bytes() == (tmp_path / "again" / name).read_bytes() for name in names)


def test_a_folder_that_is_there_is_not_written_over(folder: Path) -> None:
    with pytest.raises(OutputError, match="keyframes: cannot be made"):
        write_keyframes(folder, two_recordings())


def test_a_folder_without_a_map_is_refused(tmp_path: Path) -> None:
    assert find_keyframes(tmp_path) is None
    with pytest.raises(DataError, match=r"holds no map: there is no keyframes/index\.json; give the folder of a result"):
        read_keyframes(tmp_path)


def test_a_newer_map_says_so(folder: Path) -> None:
    change_index(folder, version=2)
    with pytest.raises(DataError, match="is of version 2, and this mqslam reads version 1"):
        read_keyframes(folder)


def change_index(folder: Path, **changed: Any) -> None:
    """Changes entries of the index."""
    index = json.loads((folder / "index.json").read_text())
    (folder / "index.json").write_text(json.dumps(index | changed))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"format": "another"}, "is not the index of a map"),
        ({"keyframes": -1}, "is damaged"),
        ({"points": "many"}, "is damaged"),
        ({"recordings": []}, "is damaged"),
        ({"recordings": [{"path": "a"}]}, "is damaged"),
        ({"recordings": [MAPPED | {"path": None}]}, "is damaged"),
        ({"recordings": [MAPPED | {"start_us": "1"}]}, "is damaged"),
        ({"recordings": [MAPPED | {"doppler_beta": math.nan}]}, "is damaged"),
        ({"recordings": [MAPPED | {"end_us": 10**30}]}, "is damaged"),
        ({"georeference": {"latitude": "north", "longitude": 0.0, "pose": [0, 0, 0]}}, "is damaged"),
        ({"georeference": {"latitude": 49.0, "longitude": 8.4, "pose": [0, "east", 0]}}, "is damaged"),
        ({"described_with": None}, "is damaged"),
    ],
)
def test_a_damaged_index_is_named(folder: Path, changed: dict[str, Any], said: str) -> None:
    change_index(folder, **changed)
    with pytest.raises(DataError, match=said) as refused:
        read_keyframes(folder)
    assert refused.value.path == folder / "index.json"


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"\xff\xfe"])
def test_an_index_that_is_none_is_named(folder: Path, content: bytes) -> None:
    (folder / "index.json").write_bytes(content)
    with pytest.raises(DataError, match="is damaged or of another kind"):
        read_keyframes(folder)


@pytest.mark.parametrize("name", ["keyframes.npy", "points.npy", "places.npy", "descriptors.npy"])
@pytest.mark.parametrize("damage", ["missing", "empty", "cut", "shorter", "other kind"])
def test_a_damaged_array_is_named(folder: Path, name: str, damage: str) -> None:
    path = folder / name
    content, array = path.read_bytes(), np.load(path)
    if damage == "missing":
        path.unlink()
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "cut":
        path.write_bytes(content[:-5])
    else:
        np.save(path, array[:-1] if damage == "shorter" else np.zeros(len(array), "<u2"))
    with pytest.raises(DataError) as refused:
        read_keyframes(folder)
    assert refused.value.path == path


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("recording", 2),
        ("recording", -1),
        ("first_point", -1),
        ("end_point", 13),
        ("first_point", 12),
        ("pose", np.nan),
        ("pose", 1e30),
        ("covariance", np.inf),
        ("travelled_m", np.nan),
    ],
)
def test_keyframes_that_do_not_fit_the_rest_are_refused(folder: Path, column: str, value: float) -> None:
    rows = np.load(folder / "keyframes.npy")
    rows[column][1] = value
    np.save(folder / "keyframes.npy", rows)
    with pytest.raises(DataError, match="does not fit the rest of the map"):
        read_keyframes(folder)


@pytest.mark.parametrize(("name", "column"), [("points.npy", "range"), ("points.npy", "x"), ("descriptors.npy", "")])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30])
def test_numbers_that_no_map_holds_are_refused(folder: Path, name: str, column: str, value: float) -> None:
    array = np.load(folder / name)
    with np.errstate(over="ignore"):  # the number is infinite in a descriptor
        (array[column] if column else array).flat[-1] = value
    np.save(folder / name, array)
    with pytest.raises(DataError, match=f"{name}: holds numbers that are not finite"):
        read_keyframes(folder)


def test_places_at_keyframes_that_are_not_there_are_refused(folder: Path) -> None:
    np.save(folder / "places.npy", np.array([0, 5]))
    with pytest.raises(DataError, match="names keyframes that the map does not have"):
        read_keyframes(folder)


@pytest.mark.parametrize("shape", [(2, 6, 4), (2, 24, 1), (2, 3, 8)])
def test_descriptors_of_another_form_than_the_index_says_are_refused(folder: Path, shape: tuple[int, int, int]) -> None:
    np.save(folder / "descriptors.npy", np.load(folder / "descriptors.npy").reshape(shape))
    with pytest.raises(DataError, match=r"descriptors\.npy: holds descriptors of places that do not fit index\.json"):
        read_keyframes(folder)
