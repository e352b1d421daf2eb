"""The layout RADIATE: `Navtech_Polar/000001.png`, one column per azimuth, with arrival stamps in `Navtech_Polar.txt`.

Source: github.com/marcelsheeny/radiate_sdk, README.md.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError
from mqslam.formats.shared.column_images import ColumnImageRecording, column_recording
from mqslam.formats.shared.images import numbered_names
from mqslam.formats.shared.sensing import Sensing
from mqslam.formats.shared.stamps import in_order, microseconds

RANGE_RESOLUTION_M = 100.0 / 576.0
_DIGITS = 6
_LINE = re.compile(r"\s*Frame:\s*(\d{1,18})\s+Time:\s*(\d+(?:\.\d+)?)\s*")
_OTHER_CLOCK = "GPS and IMU run on another clock: neither odometry nor ground truth is taken from them"


def recognises(path: Path) -> bool:
    """Whether the path holds a folder `Navtech_Polar`, or is that folder."""
    return _image_folder(path).is_dir()


def open_recording(path: Path, sensing: Sensing) -> ColumnImageRecording:
    """Index a recording of RADIATE: names, stamps and one image are read, whatever its length.

    Raises:
        DataError: no revolutions, or a file that cannot be used.
    """
    folder = _image_folder(path)
    if not folder.is_dir():
        raise DataError(path, "holds no folder Navtech_Polar/", "give the folder that holds it and Navtech_Polar.txt")
    listing = folder.parent / "Navtech_Polar.txt"
    frames, stamps = _stamps(listing)
    faults = []
    found = {int(name) for name in numbered_names(folder) if len(name) == _DIGITS}
    if unlisted := sorted(found - set(frames.tolist())):
        others = f" and {len(unlisted) - 1} others" if len(unlisted) > 1 else ""
        faults.append(f"{listing.name} has no line for frame {_name(unlisted[0])}{others}: left out")
    order = np.argsort(frames, kind="stable")
    if backward := np.flatnonzero(np.diff(frames) <= 0).tolist():
        faults.append(f"{listing.name} does not list its frames in order, first at {_name(frames[backward[0] + 1])}: sorted")
    order = order[in_order(stamps[order].tolist()) & np.append(True, np.diff(frames[order]) > 0)[: len(order)]]
    if dropped := sorted(set(frames.tolist()) - set(frames[order].tolist())):
        others = f" and of {len(dropped) - 1} others" if len(dropped) > 1 else ""
        faults.append(f"the stamp of frame {_name(dropped[0])}{others} repeats or runs backward: left out")
    present = order[np.isin(frames[order], list(found))]
    names, stamps = frames[present], stamps[present]
    missing = len(order) - len(names)
    skipped = [f"{missing} of {len(frames)} frames in {listing.name} have no image: skipped"] if missing else []
    notes = (*skipped, _OTHER_CLOCK)
    return column_recording(
        path, "radiate", folder, names, stamps, RANGE_RESOLUTION_M, sensing, digits=_DIGITS, notes=notes, faults=faults
    )


def _image_folder(path: Path) -> Path:
    """The folder of the images: the path itself if it is called Navtech_Polar, or the one inside."""
    return path.resolve() if path.resolve().name == "Navtech_Polar" else path / "Navtech_Polar"


def _name(frame: int) -> str:
    return f"{frame:0{_DIGITS}d}"


def _stamps(listing: Path) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Frames (N,) and when they arrived (N,) [us], of lines `Frame: 000001 Time: 1574859771.744660272` in s."""
    try:
        lines = [line for line in listing.read_text(encoding="utf-8").splitlines() if line.strip()]
    except (OSError, ValueError) as error:
        raise DataError(listing, "is not a readable text file", "it holds the stamps of the images") from error
    matches = [_LINE.fullmatch(line) for line in lines]
    if None in matches:
        number = matches.index(None) + 1
        raise DataError(listing, f"line {number} is not 'Frame: 000001 Time: 1574859771.744660272'", "repair it")
    rows = [match.groups() for match in matches if match]
    try:
        stamps = microseconds([word for _, word in rows], "s")
    except ValueError as error:
        raise DataError(listing, str(error), "repair it") from error
    return np.array([int(frame) for frame, _ in rows], dtype=np.int64), stamps
