"""A folder of polar images without metadata, one column per azimuth: RADIATE, and one form of MulRan."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core.recording import PolarScan, Recording
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.shared.arrivals import smooth_arrivals
from mqslam.formats.shared.azimuth_rows import even_azimuths, spread_note
from mqslam.formats.shared.images import first_readable, read_grey
from mqslam.formats.shared.sensing import Sensing
from mqslam.formats.shared.turns import find_usual_turns, place_turns


@dataclass(frozen=True, kw_only=True)
class ColumnImageRecording(Recording):
    """A recording in polar images whose azimuths carry neither stamps nor angles.

    Args:
        folder: holds the images.
        names: (N,) int64, what they are called.
        digits: least number of digits of a name.
        shape: range rows and azimuth columns of every image.
        clockwise: whether azimuths follow one another clockwise, seen from above.
    """

    folder: Path
    names: NDArray[np.int64]
    digits: int
    shape: tuple[int, int]
    clockwise: bool

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Read the revolutions start <= k < stop, one after the other."""
        for k in range(len(self))[start:stop]:
            image = _image(self.folder, int(self.names[k]), self.digits)
            pixels = read_grey(image)
            if pixels.shape != self.shape:
                sizes = [f"{rows} ranges by {columns} azimuths" for rows, columns in (pixels.shape, self.shape)]
                raise DataError(image, f"holds {sizes[0]}, the first image {sizes[1]}", "leave it out of the recording")
            stamp, duration = int(self.stamps_us[k]), int(self.turns_us[k])
            azimuths = even_azimuths(pixels.shape[1], stamp, duration, clockwise=self.clockwise)
            yield azimuths.polar_scan(np.ascontiguousarray(pixels.T), self.start_us)


def column_recording(
    path: Path,
    format: str,
    folder: Path,
    names: NDArray[np.int64],
    named_us: NDArray[np.int64],
    range_resolution: float,
    sensing: Sensing,
    *,
    digits: int = 1,
    ground_truth: Trajectory | None = None,
    notes: Iterable[str] = (),
    faults: Iterable[str] = (),
) -> ColumnImageRecording:
    """Polar images as the stream of a recording: the first that can be read is, whatever their number.

    Args:
        path: the recording.
        format: name of its layout.
        folder: holds the images.
        names: (N,) what they are called.
        named_us: (N,) increasing stamps of the revolutions [us]: their ends, unless `sensing` says otherwise.
        range_resolution: length of a range bin [m], unless `sensing` says otherwise.
        sensing: what the user says; the radar turns clockwise, unless it says otherwise.
        digits: least number of digits of a name.
        ground_truth: poses known better than any estimate, or None.
        notes: what else a user should know.
        faults: what else is wrong.

    Raises:
        DataError: no images, or half of them that cannot be used.
    """
    if not len(names):
        raise DataError(folder, "holds no revolutions", f"it should hold images named like {_image(folder, 1, digits).name}")
    shape, skipped, missing = first_readable(names.tolist(), lambda name: _shape(_image(folder, name, digits)), "first")
    names, named_us = names[skipped:], named_us[skipped:]
    stamp = sensing.stamp or "end"
    clockwise = sensing.clockwise is not False
    named_us, smoothed = smooth_arrivals(named_us)
    starts, turns = place_turns(named_us, stamp, find_usual_turns(named_us))
    return ColumnImageRecording(
        path=path,
        format=format,
        stamps_us=starts,
        turns_us=turns,
        range_resolution=sensing.range_resolution or range_resolution,
        ground_truth=ground_truth,
        notes=(*notes, spread_note("file", stamp, clockwise), *smoothed),
        faults=(*faults, *missing),
        folder=folder,
        names=names,
        digits=digits,
        shape=shape,
        clockwise=clockwise,
    )


def _shape(image: Path) -> tuple[int, int]:
    """Range rows and azimuth columns of an image."""
    rows, columns = read_grey(image).shape
    if not 2 <= columns <= rows:
        remedy = "it should hold one column per azimuth and one row per range"
        raise DataError(image, f"holds {rows} rows by {columns} columns", remedy)
    return rows, columns


def _image(folder: Path, name: int, digits: int) -> Path:
    return folder / f"{str(name).zfill(digits)}.png"
