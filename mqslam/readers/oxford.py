"""The Oxford layout: a folder with `radar/<t>.png`, one image of Oxford rows per revolution."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError
from mqslam.readers.images import read_grey
from mqslam.readers.odometry import chained, read_numbers, read_odometry
from mqslam.readers.rows import METADATA_BYTES, Azimuths, read_metadata
from mqslam.stream import RadarStream, Revolution
from mqslam.trajectory import Trajectory, checked, read_tum

RANGE_RESOLUTION_M = 0.0438
_MOST_STAMP_ERROR_US = 1_000_000
_REMEDY = "copy it anew, or mark its line in radar.timestamps with 0"


@dataclass(frozen=True, kw_only=True)
class OxfordStream(RadarStream):
    """A recording in the Oxford layout.

    Args:
        folder: holds the images, named by the stamp [us] of their first azimuth.
    """

    folder: Path

    def revolutions(self, start: int = 0, stop: int | None = None) -> Iterator[Revolution]:
        """Read the revolutions start <= k < stop, one after the other."""
        for stamp in self.stamps_us[start:stop].tolist():
            image = self.folder / f"{stamp}.png"
            pixels = read_grey(image)
            yield _azimuths(image, pixels).revolution(pixels[:, METADATA_BYTES:], self.start_us)


def recognises(path: Path) -> bool:
    """Whether the path is a folder with `radar/<t>.png` in it, or that radar folder."""
    folder = _image_folder(path)
    return folder.is_dir() and any(image.stem.isdigit() for image in folder.glob("*.png"))


def open_stream(path: Path, range_resolution: float | None) -> OxfordStream:
    """Index a recording in the Oxford layout: names and one image are read, whatever its length.

    Raises:
        DataError: no revolutions, stamps that do not increase, or a file beside them that cannot be used.
    """
    folder = _image_folder(path)
    root = folder.parent
    if not folder.is_dir():
        raise DataError(path, "holds no folder radar/", "give the folder whose radar/ holds <t>.png images")
    stamps, notes = _stamps(root, folder)
    if not len(stamps):
        raise DataError(folder, "holds no revolutions", "it should hold images named <t>.png, t in microseconds")
    if np.any(np.diff(stamps) <= 0):
        at = int(stamps[int(np.argmax(np.diff(stamps) <= 0)) + 1])
        raise DataError(root / "radar.timestamps", f"stamps do not increase at {at}", "sort it and drop duplicates")
    resolution, assumed = _range_resolution(root, range_resolution)
    last = folder / f"{stamps[-1]}.png"
    end_us = _azimuths(last, read_grey(last)).end_us
    truth, broken = _ground_truth(root, int(stamps[0]), end_us)
    odometry = root / "odom.csv"
    return OxfordStream(
        path=path,
        format="oxford",
        stamps_us=stamps,
        end_us=end_us,
        range_resolution=resolution,
        odometry=read_odometry(odometry) if odometry.exists() else None,
        ground_truth=truth,
        notes=(*notes, *assumed, *broken),
        folder=folder,
    )


def _image_folder(path: Path) -> Path:
    """The folder of the images: the path itself if it is called radar, or the radar folder inside."""
    return path if path.resolve().name == "radar" and not (path / "radar").is_dir() else path / "radar"


def _azimuths(image: Path, pixels: NDArray[np.uint8]) -> Azimuths:
    """The azimuths of an image, once they have been found to belong to its name."""
    try:
        azimuths = read_metadata(pixels)
    except ValueError as error:
        raise DataError(image, str(error), _REMEDY) from error
    apart = int(azimuths.stamps_us[0]) - int(image.stem)
    if abs(apart) > _MOST_STAMP_ERROR_US:
        raise DataError(image, f"its first row is stamped {apart * 1e-6:.1f} s after its name", _REMEDY)
    return azimuths


def _stamps(root: Path, folder: Path) -> tuple[NDArray[np.int64], list[str]]:
    """Stamps (N,) [us] of the revolutions that are there, and what was left out."""
    names = (image.stem for image in folder.glob("*.png"))
    found = {int(name) for name in names if name.isdecimal() and len(name) < 19 and str(int(name)) == name}
    listing = root / "radar.timestamps"
    if not listing.exists():
        return np.array(sorted(found), dtype=np.int64), []
    try:
        rows = [line.split() for line in listing.read_text(encoding="utf-8").splitlines() if line.strip()]
        listed = [(int(row[0]), row[1:2] != ["0"]) for row in rows]
    except (OSError, ValueError) as error:
        raise DataError(listing, "has lines other than '<t> 1'", "repair it, or remove it to use all images") from error
    kept = [stamp for stamp, present in listed if present and stamp in found]
    notes = []
    if len(kept) < len(listed):
        skipped = len(listed) - len(kept)
        notes.append(f"{skipped} of {len(listed)} revolutions in radar.timestamps have no image: skipped")
    if extra := len(found - {stamp for stamp, _ in listed}):
        notes.append(f"{extra} images are not listed in radar.timestamps: left out")
    return np.array(kept, dtype=np.int64), notes


def _range_resolution(root: Path, given: float | None) -> tuple[float, list[str]]:
    """Length of a range bin [m], and a note where it is assumed."""
    if given is not None:
        return given, []
    for file in (root / "twin.json", root / "simulation.json"):
        if not file.exists():
            continue
        try:
            value = float(json.loads(file.read_text(encoding="utf-8"))["range_resolution_m"])
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(value)
        except (OSError, ValueError, KeyError, TypeError) as error:
            remedy = "repair it or give --range-resolution"
            raise DataError(file, "names no range_resolution_m above zero", remedy) from error
        return value, []
    return RANGE_RESOLUTION_M, [
        f"range resolution {RANGE_RESOLUTION_M} m assumed, the best fit to Oxford's radar (published: 0.0432 m): "
        "--range-resolution overrides it"
    ]


def _ground_truth(root: Path, start_us: int, end_us: int) -> tuple[Trajectory | None, list[str]]:
    """Ground truth of the recording, or None, and what was left out of it."""
    tum, csv = root / "gt" / "poses_tum.txt", root / "gt" / "radar_odometry.csv"
    if tum.exists():
        return read_tum(tum), []
    if not csv.exists():
        return None, []
    table = read_numbers(csv, [0, 1, 2, 3, 7])
    table = table[np.argsort(table[:, 0], kind="stable")]
    later, earlier = np.round(table[:, :2]).astype(np.int64).T
    inside = (later > start_us) & (earlier < end_us)
    table, later, earlier = table[inside], later[inside], earlier[inside]
    if not len(table):
        return None, [f"{csv.name} has no row within the recording: no ground truth"]
    breaks = np.flatnonzero(earlier[1:] != later[:-1]) + 1
    pieces = np.split(np.arange(len(table)), breaks)
    longest = max(pieces, key=len)
    notes = [f"{csv.name} has {len(breaks)} breaks: the longest stretch is the ground truth"] if len(breaks) else []
    steps = table[longest][:, 2:] * [1.0, -1.0, -1.0]
    return checked(csv, np.append(earlier[longest[0]], later[longest]), chained(steps)), notes
