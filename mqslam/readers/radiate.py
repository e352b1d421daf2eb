"""The layout RADIATE: `Navtech_Polar/000001.png`, one column per azimuth, with arrival stamps in `Navtech_Polar.txt`.

Source: github.com/marcelsheeny/radiate_sdk, README.md.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError
from mqslam.readers.column_images import ColumnImageStream, column_stream
from mqslam.readers.sensing import Sensing
from mqslam.readers.stamps import microseconds

RANGE_RESOLUTION_M = 100.0 / 576.0
_DIGITS = 6
_LINE = re.compile(r"\s*Frame:\s*(\d+)\s+Time:\s*(\d+(?:\.\d+)?)\s*")
_OTHER_CLOCK = "GPS and IMU run on another clock: neither odometry nor ground truth is taken from them"


def recognises(path: Path) -> bool:
    """Whether the path holds a folder `Navtech_Polar`, or is that folder."""
    return _image_folder(path).is_dir()


def open_stream(path: Path, sensing: Sensing) -> ColumnImageStream:
    """Index a recording of RADIATE: names, stamps and one image are read, whatever its length.

    Raises:
        DataError: no revolutions, an image without a stamp, stamps that do not increase, or a file that cannot be used.
    """
    folder = _image_folder(path)
    if not folder.is_dir():
        raise DataError(path, "holds no folder Navtech_Polar/", "give the folder that holds it and Navtech_Polar.txt")
    listing = folder.parent / "Navtech_Polar.txt"
    frames, stamps = _stamps(listing)
    found = {int(image.stem) for image in folder.glob("*.png") if image.stem.isdecimal() and len(image.stem) == _DIGITS}
    if unlisted := sorted(found - set(frames.tolist())):
        others = f" and {len(unlisted) - 1} others" if len(unlisted) > 1 else ""
        problem = f"has no line for frame {unlisted[0]:0{_DIGITS}d}{others}"
        raise DataError(listing, problem, "complete it, or remove their images")
    kept = np.isin(frames, list(found))
    names, stamps = frames[kept], stamps[kept]
    if np.any(np.diff(stamps) <= 0):
        at = int(names[int(np.argmax(np.diff(stamps) <= 0)) + 1])
        raise DataError(listing, f"stamps do not increase at frame {at:0{_DIGITS}d}", "sort it and drop duplicates")
    missing = len(frames) - len(names)
    skipped = [f"{missing} of {len(frames)} frames in {listing.name} have no image: skipped"] if missing else []
    notes = (*skipped, _OTHER_CLOCK)
    return column_stream(
        path, "radiate", folder, names, stamps, RANGE_RESOLUTION_M, sensing, digits=_DIGITS, notes=notes
    )


def _image_folder(path: Path) -> Path:
    """The folder of the images: the path itself if it is called Navtech_Polar, or the one inside."""
    return path.resolve() if path.resolve().name == "Navtech_Polar" else path / "Navtech_Polar"


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
    return np.array([int(frame) for frame, _ in rows], dtype=np.int64), microseconds([word for _, word in rows], "s")
