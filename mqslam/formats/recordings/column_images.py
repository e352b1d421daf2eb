"""Reads and writes folders of polar images without metadata, one column per azimuth: RADIATE, and one form of MulRan."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.recording import PolarScan, Recording
from mqslam.errors import DataError, untrusted
from mqslam.formats.images import read_first, read_grey, write_png
from mqslam.formats.recordings.arrivals import estimate_arrivals
from mqslam.formats.recordings.azimuths import note_spread, spread_azimuths
from mqslam.formats.recordings.layout import Sensing
from mqslam.formats.recordings.lost_columns import Restorer
from mqslam.formats.recordings.turns import find_usual_turns, place_turns

_MOST_STEPS = 0.75  # [steps] a polar image cannot hold azimuths that lie further than this from even steps
_NOTED_DEG = 0.05  # smaller deviations of azimuths from even steps are not worth a note
_REMEDY = "convert it to a layout that keeps times and angles: oxford, boreas, mulran_oxford, a bag or .npz"


@dataclass(frozen=True, slots=True)
class ColumnImages:
    """The images of a recording: each is a file `<name>.png` whose name is a number.

    Args:
        folder: folder of the images.
        names: (N,) int64, the numbers that name the images.
        digits: number of digits to which the names of the files are padded with zeros.
    """

    folder: Path
    names: NDArray[np.int64]
    digits: int = 1

    def path(self, name: int) -> Path:
        """Returns the path of an image by its name."""
        return self.folder / f"{str(name).zfill(self.digits)}.png"

    def read_shape(self, name: int) -> tuple[int, int]:
        """Reads how many rows (range bins) and how many columns (azimuths) an image has.

        Raises:
            DataError: the image cannot be read, has fewer than two columns, or has more columns than rows.
        """
        rows, columns = read_grey(self.path(name)).shape
        if not 2 <= columns <= rows:
            remedy = "it should hold one column per azimuth and one row per range bin"
            raise DataError(self.path(name), f"holds {rows} rows by {columns} columns", remedy)
        return rows, columns


@dataclass(frozen=True, kw_only=True)
class ColumnImageRecording(Recording):
    """A recording in polar images whose azimuths carry neither stamps nor angles.

    Args:
        images: the images, one per polar scan.
        shape: number of rows (range bins) and number of columns (azimuths) of every image.
        clockwise: whether azimuths follow one another clockwise, seen from above.
    """

    images: ColumnImages
    shape: tuple[int, int]
    clockwise: bool

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Reads the polar scans start <= k < stop.

        If the recorder lost azimuths, columns are moved to the azimuths that they show, and lost azimuths are marked as not
        measured.
        """
        restorer = Restorer(self._read_image, len(self))
        with untrusted.blame_file(self.path):
            for k in range(len(self))[start:stop]:
                pixels, measured = restorer.restore(k)
                stamp, duration = int(self.stamps_us[k]), int(self.turns_us[k])
                azimuths = spread_azimuths(pixels.shape[1], stamp, duration, clockwise=self.clockwise)
                polar_scan = azimuths.to_polar_scan(np.ascontiguousarray(pixels.T), self.start_us)
                yield replace(polar_scan, valid=polar_scan.valid & measured)

    def _read_image(self, k: int) -> NDArray[np.uint8]:
        """Reads the pixels (R, A) of image k; raises a DataError if they do not have the recording's shape."""
        image = self.images.path(int(self.images.names[k]))
        pixels = read_grey(image)
        if pixels.shape != self.shape:
            sizes = [f"{rows} ranges by {columns} azimuths" for rows, columns in (pixels.shape, self.shape)]
            raise DataError(image, f"holds {sizes[0]}, the first image {sizes[1]}", "leave it out of the recording")
        return pixels


def open_columns(
    path: Path,
    format: str,
    images: ColumnImages,
    named_us: NDArray[np.int64],
    numbers: NDArray[np.int64] | None,
    bin_length: tuple[float, list[str]],
    sensing: Sensing,
) -> ColumnImageRecording:
    """Indexes polar images by their names; reads no image but the first that can be read.

    Args:
        path: the recording.
        format: name of its layout.
        images: the images.
        named_us: (N,) stamps of arrival [us] of the N images: ends of revolutions, unless `sensing` states otherwise.
        numbers: (N,) increasing numbers that the recorder gave to polar scans; some may be missing. None: none is missing.
        bin_length: (1) the length of a range bin [m]; (2) a list with a note for the user if this length is assumed.
        sensing: the properties of the radar that the user states; it spins clockwise unless they state otherwise.

    Raises:
        DataError: there are no images, or each of the first half of them cannot be used.
    """
    if not len(images.names):
        raise DataError(images.folder, "holds no polar scans", f"it should hold images named like {images.path(1).name}")
    shape, skipped, missing = read_first(images.names.tolist(), images.read_shape, "first")
    stamp = sensing.stamp or "end"
    clockwise = sensing.clockwise is not False
    arrivals = estimate_arrivals(named_us[skipped:], None if numbers is None else numbers[skipped:])
    resolution, assumed = bin_length
    starts, turns = place_turns(arrivals.stamps_us, stamp, find_usual_turns(arrivals.stamps_us))
    return ColumnImageRecording(
        path=path,
        format=format,
        stamps_us=starts,
        turns_us=turns,
        range_resolution=resolution,
        is_resolution_assumed=bool(assumed),
        stamp_sigma_s=arrivals.sigma_s,
        notes=(*assumed, note_spread("file", stamp, clockwise), *arrivals.notes),
        faults=(*missing, *arrivals.faults),
        images=replace(images, names=images.names[skipped:]),
        shape=shape,
        clockwise=clockwise,
    )


def write_columns(folder: Path, recording: Recording, names: Sequence[str]) -> list[str]:
    """Writes a polar image `<name>.png` per polar scan into a folder, one polar scan in memory at a time.

    The first column of an image is the azimuth straight ahead. If revolutions begin one azimuth later, as Oxford's do, this
    column shows the last azimuth of the revolution before, and is black in the first image and after a gap.

    Args:
        folder: folder for the images.
        recording: the recording.
        names: (N,) names of the images.

    Returns:
        Notes for the user on the data that the images do not hold.

    Raises:
        DataError: a polar scan has one azimuth or does not fit into polar images (see `_find_misfit`).
    """
    shape, apart, clockwise, late = (0, 0), 0.0, True, False
    # where revolutions begin one step late, the last azimuth of each is the first column of the next image
    ahead: NDArray[np.uint8] | None = None
    follows = np.append(False, recording.ends_us[:-1] == recording.stamps_us[1:])
    for k, polar_scan in enumerate(recording.polar_scans()):
        if len(polar_scan.azimuths) < 2:
            raise DataError(
                recording.path, f"polar scan {k} has one azimuth, and this layout needs two", "convert it to .npz"
            )
        if k == 0:
            shape, clockwise = polar_scan.power.shape, bool(polar_scan.azimuths[-1] <= polar_scan.azimuths[0])
            late = _measure_deviation(polar_scan, clockwise, 1) < _measure_deviation(polar_scan, clockwise, 0)
        off = _measure_deviation(polar_scan, clockwise, int(late))
        if problem := _find_misfit(k, polar_scan, shape, off):
            raise DataError(recording.path, problem, _REMEDY)
        apart = max(apart, off)
        power = polar_scan.power
        if late:
            first = ahead if ahead is not None and follows[k] else np.zeros(shape[1], dtype=np.uint8)
            power, ahead = np.vstack([first, power[:-1]]), power[-1]
        write_png(folder / f"{names[k]}.png", np.ascontiguousarray(power.T))
    notes = ["azimuths lose their own times and angles: polar images hold one stamp per turn, its end"]
    if np.rad2deg(apart) > _NOTED_DEG:
        notes.append(f"azimuths lie up to {np.rad2deg(apart):.2f} deg off the even steps at which readers will place them")
    if not clockwise:
        notes.append("the radar turns counter-clockwise: read the result with sensor: {clockwise: false}")
    return notes


def _find_misfit(k: int, polar_scan: PolarScan, shape: tuple[int, int], off: float) -> str:
    """Returns the reason why polar images cannot hold polar scan k, or "" if they can.

    Args:
        k: index of the polar scan.
        polar_scan: polar scan k.
        shape: number of azimuths and number of range bins of the first polar scan.
        off: largest angle [rad] between an azimuth and the even step at which readers will place it.
    """
    if polar_scan.power.shape != shape:
        sizes = [f"{azimuths} azimuths by {bins} bins" for azimuths, bins in (polar_scan.power.shape, shape)]
        return f"polar scan {k} has {sizes[0]}, the first {sizes[1]}; all polar images must have one size"
    if shape[0] > shape[1]:
        return f"has more azimuths ({shape[0]}) than range bins ({shape[1]})"
    if off * shape[0] > _MOST_STEPS * 2.0 * np.pi:
        where = f"azimuths of polar scan {k} lie {np.rad2deg(off):.2f} deg off the even steps from straight ahead"
        return f"{where} that polar images assume"
    return ""


def _measure_deviation(polar_scan: PolarScan, clockwise: bool, late: int) -> float:
    """Returns the largest angle [rad] between azimuths and even steps that begin `late` steps after straight ahead."""
    even = spread_azimuths(len(polar_scan.azimuths), 0, 0, clockwise=clockwise).angles
    even = even + late * (even[1] - even[0])
    return float(np.abs(se2.wrap(polar_scan.azimuths - even)).max())
