"""Reads folders of images of Oxford rows (see `azimuths`), one per polar scan: Oxford, Boreas, and one form of MulRan."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core.recording import PolarScan, Recording
from mqslam.core.wording import count_of
from mqslam.errors import DataError, untrusted
from mqslam.formats.images import read_first, read_grey
from mqslam.formats.recordings.azimuths import (
    FLAG_BYTE,
    METADATA_BYTES,
    TURN_TICKS,
    Azimuths,
    check_encoder,
    read_metadata,
    stamps_in_us,
)
from mqslam.formats.recordings.layout import Sensing
from mqslam.formats.recordings.turns import find_usual_turns, place_turns

# An image with less than this share of the first image's number of azimuths is damaged, and is left out.
_FEWEST_ROWS = 0.1
# Byte 10 of a row states whether the azimuth was measured if it is 255 in more than this share of the first image's rows,
# because few azimuths of a recording are not measured.
_VALIDITY_SHARE = 0.75
# Otherwise byte 10 is the direction of the chirp, which alternates in Boreas-RT, if it is 255 in more than this share of
# the rows. If it is 255 in fewer rows, it states nothing about single azimuths: Boreas leaves it unused.
_CHIRP_SHARE = 0.25
_MOST_STAMP_ERROR_US = 1_000_000  # an image is damaged if the stamp in its name lies further than this outside its turn
_REMEDY = "copy the file again, or leave it out of the recording"


class Flag(Enum):
    """Meaning of byte 10, the flag byte, in the Oxford rows of a recording."""

    VALIDITY = "255 where the azimuth was measured"
    CHIRP = "255 where the chirp went up"
    NOTHING = "nothing about single azimuths"


@dataclass(frozen=True, slots=True)
class RowFolder:
    """A folder of images of Oxford rows, and how its images are read.

    Args:
        path: the folder.
        flag: meaning of byte 10 of the rows.
        encoder: encoder ticks per turn.
        usual: number of azimuths of the first image; 0 until this image is read.
    """

    path: Path
    flag: Flag
    encoder: int
    usual: int = 0

    def read(self, name: int) -> tuple[Azimuths, NDArray[np.uint8], NDArray[np.bool_]]:
        """Reads the azimuths of an image and their power.

        Args:
            name: name of the image: a stamp [us or ns] within its turn.

        Returns:
            The azimuths (A,), their power (A, B), and a mask (A,) of the up-chirps: all azimuths unless byte 10 states the
            directions of chirps.

        Raises:
            DataError: the image cannot be used, or its stamps do not fit its name.
        """
        image = self.path / f"{name}.png"
        pixels = read_grey(image)
        try:
            azimuths = read_metadata(pixels, flags_validity=self.flag is Flag.VALIDITY, turn=self.encoder)
            rising = (pixels[:, FLAG_BYTE] == 255) | (self.flag is not Flag.CHIRP)
            stamps_us = azimuths.stamps_us[rising]
            if len(stamps_us) < 2:
                raise ValueError(f"has {count_of(len(stamps_us), 'up-chirp')}")
            if len(stamps_us) < _FEWEST_ROWS * self.usual:
                raise ValueError(f"has {len(stamps_us)} azimuths, the first image has {self.usual}")
        except ValueError as error:
            raise DataError(image, str(error), _REMEDY) from error
        apart = int(stamps_us[0]) - int(stamps_in_us(np.asarray(name)))
        span = int(stamps_us[-1]) - int(stamps_us[0])
        if not -span - _MOST_STAMP_ERROR_US <= apart <= _MOST_STAMP_ERROR_US:
            raise DataError(image, f"its first row is stamped {apart * 1e-6:.1f} s after the stamp in its name", _REMEDY)
        return azimuths, pixels[:, METADATA_BYTES:], rising

    def read_rising(self, name: int) -> Azimuths:
        """Reads the azimuths of an image's up-chirps, given its name; all azimuths unless byte 10 marks up-chirps.

        Raises:
            DataError: the image cannot be used, or its stamps do not fit its name.
        """
        azimuths, _, rising = self.read(name)
        return azimuths.take(rising)


@dataclass(frozen=True, kw_only=True)
class RowImageRecording(Recording):
    """A recording in images of Oxford rows.

    Args:
        folder: folder of the images.
        names: (N,) int64, names of the images: increasing stamps [us or ns].
    """

    folder: RowFolder
    names: NDArray[np.int64]

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Reads the polar scans start <= k < stop."""
        with untrusted.blame_file(self.path):
            for name in self.names[start:stop].tolist():
                azimuths, power, rising = self.folder.read(name)
                polar_scan = azimuths.to_polar_scan(power, self.start_us)
                yield polar_scan.split(rising) if self.folder.flag is Flag.CHIRP else polar_scan


def open_rows(
    path: Path,
    format: str,
    folder: Path,
    names: NDArray[np.int64],
    bin_length: tuple[float, list[str]],
    sensing: Sensing,
) -> RowImageRecording:
    """Indexes images by their names; reads the first and the last readable image, and a few others.

    An image is named after an instant of its turn: in Oxford the first azimuth, in Boreas the middle, in MulRan the end. The
    first image shows which share of a turn lies before this instant. The share is taken to be the same in all images. If the
    instant lies outside the turn of the first image, the time from a turn's start to its instant is taken to be the same.

    Args:
        path: the recording.
        format: name of its layout.
        folder: folder of the images.
        names: (N,) names of the images, increasing.
        bin_length: (1) the length of a range bin [m]; (2) a list with a note for the user if this length is assumed.
        sensing: the properties of the radar that the user states.

    Raises:
        DataError: there are no images, the first or the last half of them cannot be used, or the azimuths show another
            number of encoder ticks per turn than is assumed.
    """
    if not len(names):
        raise DataError(folder, "holds no polar scans", "it should hold images named <t>.png, t in microseconds")

    def read_with_flag(name: int) -> tuple[RowFolder, tuple[str, ...], Azimuths]:
        flag, notes = _interpret_flag(read_grey(folder / f"{name}.png"))
        images = RowFolder(folder, flag, sensing.encoder_size or TURN_TICKS)
        return images, notes, images.read_rising(name)

    (images, notes, first), skipped, faults = read_first(names.tolist(), read_with_flag, "first")
    whole = replace(images, usual=len(first.stamps_us))
    names = names[skipped:]
    last, skipped, missing = read_first(names[::-1].tolist(), whole.read_rising, "last")
    names = names[: len(names) - skipped]
    named_us = stamps_in_us(names)
    known = {0: first, len(names) - 1: last}
    if sensing.encoder_size is None:
        faults = [*faults, *check_encoder(folder, named_us, [azimuths.measure_turn() for azimuths in (first, last)])]

    def measure(k: int) -> float | None:
        try:
            azimuths = known[k] if k in known else images.read_rising(int(names[k]))
        except DataError:
            return None
        return azimuths.measure_turn()

    usual = find_usual_turns(named_us, measure)
    before = place_turns(named_us, "end", usual)[1]
    before[0] = first.find_duration() or before[0]
    lead = int(named_us[0]) - int(first.stamps_us[0])
    within = 0 <= lead <= before[0]
    starts = named_us - (np.round(lead * before / before[0]).astype(np.int64) if within else lead)
    turns = place_turns(starts, "start", usual)[1]
    duration = last.find_duration()
    if duration is not None:
        turns[-1] = max(1, int(last.stamps_us[0]) + duration - int(starts[-1]))
    resolution, assumed = bin_length
    return RowImageRecording(
        path=path,
        format=format,
        stamps_us=starts,
        turns_us=turns,
        range_resolution=resolution,
        is_resolution_assumed=bool(assumed),
        notes=(*assumed, *sensing.note_unused(), *notes),
        faults=(*faults, *missing),
        folder=whole,
        names=names,
    )


def _interpret_flag(pixels: NDArray[np.uint8]) -> tuple[Flag, tuple[str, ...]]:
    """Finds the meaning of byte 10 in the first image (A, 11 + B) of a recording, by the share of rows where it is 255.

    Also returns a note for the user unless the byte states validity.
    """
    share = float(np.mean(pixels[:, FLAG_BYTE] == 255)) if pixels.shape[1] > METADATA_BYTES else 1.0
    if share > _VALIDITY_SHARE:
        return Flag.VALIDITY, ()
    if share > _CHIRP_SHARE:
        return Flag.CHIRP, (
            f"byte 10 is 255 in {share:.0%} of the rows and is taken as the direction of the chirp "
            "(Boreas-RT); up-chirps and down-chirps have opposite Doppler shifts, so only the up-chirps (255) give returns",
        )
    return Flag.NOTHING, (
        f"byte 10 is 255 in {share:.0%} of the rows and is taken as unused or as down-chirps "
        "(Boreas-RT, where doppler_beta is below zero), not as azimuths that were not measured",
    )
