"""Writes and reads the keyframes of a map as a folder, so that the map can be used without the recordings.

    index.json       format, version, sizes, recordings, place on the Earth, and settings with which places were described
    keyframes.npy    (K,) one record per keyframe, in the units and frames of `mqslam.core.keyframes.Keyframes`
    points.npy       (M,) one record per return, as `KEYFRAME_POINT` describes; the returns of a keyframe follow each other
    places.npy       (P,) index of the keyframe at each place
    descriptors.npy  (P, R, S) descriptor of each place, by rings and sectors

The .npy files are in NumPy's own format, so that any program that reads this format can read a map. Points and descriptors
are checked once when a map is opened, and then loaded from the disk as they are needed.
"""

from __future__ import annotations

import json
from dataclasses import asdict, astuple
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core.keyframes import KEYFRAME_POINT, KeyframeMap, Keyframes, MappedRecording, PlaceTable
from mqslam.core.sensors import Georeference, TangentPlane
from mqslam.core.stored import release
from mqslam.errors import DataError, Remedy, untrusted
from mqslam.execution.files import blame_output, write_aside, write_json
from mqslam.formats.poses import mark_places
from mqslam.formats.stamps import LATEST_US
from mqslam.version import __version__

FOLDER: Final = "keyframes"
"""Name of the folder of keyframes within a result."""
_FORMAT: Final = "mqslam keyframes"
_VERSION: Final = 1
_KEYFRAME: Final = np.dtype(
    [
        ("recording", "<i4"),
        ("scan", "<i8"),
        ("stamp_us", "<i8"),
        ("pose", "<f8", 3),
        ("covariance", "<f8", (3, 3)),
        ("travelled_m", "<f8"),
        ("first_point", "<i8"),
        ("end_point", "<i8"),
    ]
)
_AT_A_TIME: Final = 1_000_000  # numbers of a file that are checked at a time
_REMEDY: Final = "give the folder of a result that `mqslam run` or `mqslam merge` has written"


def write_keyframes(folder: Path, made: KeyframeMap) -> None:
    """Writes the keyframes of a map into a new folder.

    Args:
        folder: the folder, which must not exist yet.
        made: the map.

    Raises:
        OutputError: the folder or a file cannot be written.
    """
    keyframes, places = made.keyframes, made.places
    with blame_output(folder, "made", Remedy.CHOOSE_OUTPUT):
        folder.mkdir()
    rows = np.zeros(len(keyframes), _KEYFRAME)
    rows["recording"], rows["scan"], rows["stamp_us"] = keyframes.origins, keyframes.scans, keyframes.stamps_us
    rows["pose"], rows["covariance"], rows["travelled_m"] = keyframes.poses, keyframes.covariances, keyframes.travelled
    rows["first_point"], rows["end_point"] = keyframes.rows.T
    arrays = {
        "keyframes": rows,
        "points": keyframes.points,
        "places": places.keyframes.astype("<i8"),
        "descriptors": places.descriptors.astype("<f2"),
    }
    for name, array in arrays.items():
        with write_aside(folder / f"{name}.npy") as aside, aside.open("wb") as file:
            np.save(file, array)
    place = keyframes.georeference
    write_json(
        folder / "index.json",
        {
            "format": _FORMAT,
            "version": _VERSION,
            "mqslam_version": __version__,
            "keyframes": len(keyframes),
            "points": len(keyframes.points),
            "places": len(places.keyframes),
            "recordings": [  # only a recording of a lidar has a unit
                {name: value for name, value in asdict(recording).items() if value is not None}
                for recording in keyframes.recordings
            ],
            "georeference": None
            if place is None
            else {"latitude": place.plane.latitude, "longitude": place.plane.longitude, "pose": place.pose.tolist()},
            "described_with": places.made_with,
        },
    )


def find_keyframes(path: Path) -> Path | None:
    """Returns the folder of keyframes at a path: the path itself, or `keyframes/` inside it; None if neither is one."""
    for folder in (path, path / FOLDER):
        if (folder / "index.json").is_file():
            return folder
    return None


@untrusted.reads_file
def read_keyframes(path: Path) -> KeyframeMap:
    """Opens a map and checks it; its points and descriptors stay on the disk, and are loaded as they are needed.

    Args:
        path: the folder of keyframes, or the folder of the result that holds it.

    Raises:
        DataError: there is no map, the map is damaged, or its format has another version.
    """
    folder = find_keyframes(path)
    if folder is None:
        raise DataError(path, f"holds no map: there is no {FOLDER}/index.json", _REMEDY)
    index = _read_index(folder / "index.json")
    rows = _read_array(folder / "keyframes.npy", _KEYFRAME, (index["keyframes"],))
    points = _read_array(folder / "points.npy", KEYFRAME_POINT, (index["points"],))
    places = _read_array(folder / "places.npy", np.dtype("<i8"), (index["places"],))
    descriptors = _read_array(folder / "descriptors.npy", np.dtype("<f2"), (index["places"], None, None))
    described_with = index["described_with"]
    if len(places) and descriptors.shape[1:] != (described_with.get("rings"), described_with.get("sectors")):
        raise DataError(folder / "descriptors.npy", "holds descriptors of places that do not fit index.json", _REMEDY)
    recordings = index["recordings"]
    spans = np.column_stack([rows["first_point"], rows["end_point"]])
    sound = (spans >= 0).all() and (spans <= len(points)).all() and (np.diff(spans) >= 0).all()
    sound &= np.isin(rows["recording"], np.arange(len(recordings))).all()
    sound &= (
        mark_places(np.column_stack([rows["pose"], rows["travelled_m"]])).all() and not np.isinf(rows["covariance"]).any()
    )
    if not sound:
        raise DataError(folder / "keyframes.npy", "does not fit the rest of the map", _REMEDY)
    _check_numbers(folder / "points.npy", points.view("<f4"))
    _check_numbers(folder / "descriptors.npy", descriptors.reshape(-1))
    if not (((places >= 0) & (places < len(rows))).all()):
        raise DataError(folder / "places.npy", "names keyframes that the map does not have", _REMEDY)
    keyframes = Keyframes(
        recordings=recordings,
        origins=rows["recording"].astype(np.int64),
        scans=rows["scan"].astype(np.int64),
        stamps_us=rows["stamp_us"].astype(np.int64),
        poses=rows["pose"].astype(np.float64),
        covariances=rows["covariance"].astype(np.float64),
        travelled=rows["travelled_m"].astype(np.float64),
        rows=spans.astype(np.int64),
        points=points,
        georeference=index["georeference"],
    )
    return KeyframeMap(keyframes, PlaceTable(np.array(places), descriptors, described_with))


def _check_numbers(path: Path, numbers: NDArray[Any]) -> None:
    """Checks that the numbers (N,) of a memory-mapped file are finite and at most 1e9, and frees the memory of the file."""
    for begin in range(0, len(numbers), _AT_A_TIME):
        if not mark_places(numbers[begin : begin + _AT_A_TIME, None].astype(np.float32)).all():
            raise DataError(path, "holds numbers that are not finite, or far too large", _REMEDY)
        release(numbers)


@untrusted.reads_file
def _read_index(path: Path) -> dict[str, Any]:
    """Returns the content of index.json after a check, with its recordings and its place on the Earth as objects.

    Raises:
        DataError: the file cannot be read, is damaged, or is no index of a map in the version that this code reads.
    """
    index = json.loads(untrusted.read_document(path))
    if index["format"] != _FORMAT:
        raise DataError(path, "is not the index of a map", _REMEDY)
    version = int(index["version"])
    if version != _VERSION:
        raise DataError(path, f"is of version {version}, and this mqslam reads version {_VERSION}", "make the map again")
    sizes = [int(index[name]) for name in ("keyframes", "points", "places")]
    if min(sizes) < 0 or not index["recordings"] or not isinstance(index["described_with"], dict):
        raise ValueError("its sizes, recordings or settings are not those of a map")
    recordings = tuple(MappedRecording(**recording) for recording in index["recordings"])
    for recording in recordings:
        name, *numbers = (value for value in astuple(recording) if value is not None)
        if not isinstance(name, str) or not all(abs(number) < LATEST_US for number in numbers):
            raise ValueError("a recording has no name, or a number that is far too large")
        if not (recording.unit_m or 1.0) > 0.0:
            raise ValueError("a recording has a unit that is no length")
    where = index["georeference"]
    if where is not None:
        stated = np.array([where["latitude"], where["longitude"], *where["pose"]], dtype=np.float64)
        if len(stated) != 5 or not np.isfinite(stated).all():
            raise ValueError("its place on the Earth is not made of finite numbers")
        where = Georeference(TangentPlane(*stated[:2].tolist()), stated[2:])
    return {**index, "recordings": recordings, "georeference": where}


@untrusted.reads_file
def _read_array(path: Path, kind: np.dtype[Any], shape: tuple[int | None, ...]) -> NDArray[Any]:
    """Opens the array in a file as a memory map, and checks its type and shape; None in the shape allows any length."""
    array: NDArray[Any] = np.load(untrusted.check_file(path), mmap_mode="r" if 0 not in shape else None, allow_pickle=False)
    fits = array.dtype == kind and array.ndim == len(shape)
    if not fits or any(n is not None and n != m for n, m in zip(shape, array.shape, strict=True)):
        raise DataError(path, f"holds an array {array.shape} of {array.dtype}, which does not fit index.json", _REMEDY)
    return array
