"""A folder of images of Oxford rows, one per revolution: Oxford, Boreas, and one form of MulRan."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core.recording import PolarScan, Recording
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.shared.azimuth_rows import FLAG_BYTE, METADATA_BYTES, Azimuths, in_us, read_metadata
from mqslam.formats.shared.images import first_readable, read_grey
from mqslam.formats.shared.turns import find_usual_turns, place_turns

_MOST_STAMP_ERROR_US = 1_000_000  # of a name, beyond the revolution that it is an instant of
_FEWEST_AZIMUTHS = 0.1  # share of the usual number, below which an image is no revolution
_REMEDY = "copy it anew, or leave it out of the recording"


class Flag(Enum):
    """What byte 10 of the rows of a recording tells."""

    VALIDITY = "255 where the azimuth was measured"
    CHIRP = "255 where the chirp went up"
    NOTHING = "nothing about single azimuths"


@dataclass(frozen=True, kw_only=True)
class RowImageRecording(Recording):
    """A recording in images of Oxford rows.

    Args:
        folder: holds the images.
        names: (N,) int64, what they are called.
        flag: what byte 10 of their rows tells.
        usual: number of azimuths of the first.
    """

    folder: Path
    names: NDArray[np.int64]
    flag: Flag
    usual: int

    def polar_scans(self, start: int = 0, stop: int | None = None) -> Iterator[PolarScan]:
        """Read the revolutions start <= k < stop, one after the other."""
        for name in self.names[start:stop].tolist():
            azimuths, power = _read(self.folder, name, self.flag, self.usual)
            yield azimuths.polar_scan(power, self.start_us)


@dataclass(frozen=True, slots=True)
class RowImages:
    """The images of a recording, indexed.

    Args:
        folder: holds the images.
        names: (N,) int64, what they are called: increasing stamps [us or ns].
        stamps_us: (N,) int64 [us], when their revolutions begin.
        turns_us: (N,) int64 [us], how long they take.
        flag: what byte 10 of their rows tells.
        usual: number of azimuths of the first.
        notes: how that was understood.
        faults: what could not be read.
    """

    folder: Path
    names: NDArray[np.int64]
    stamps_us: NDArray[np.int64]
    turns_us: NDArray[np.int64]
    flag: Flag
    usual: int
    notes: tuple[str, ...]
    faults: tuple[str, ...]

    def recording(
        self,
        path: Path,
        format: str,
        range_resolution: float,
        *,
        odometry: Trajectory | None = None,
        ground_truth: Trajectory | None = None,
        notes: Iterable[str] = (),
        faults: Iterable[str] = (),
    ) -> RowImageRecording:
        """The images as the stream of a recording at a path."""
        return RowImageRecording(
            path=path,
            format=format,
            stamps_us=self.stamps_us,
            turns_us=self.turns_us,
            range_resolution=range_resolution,
            odometry=odometry,
            ground_truth=ground_truth,
            notes=(*notes, *self.notes),
            faults=(*faults, *self.faults),
            folder=self.folder,
            names=self.names,
            flag=self.flag,
            usual=self.usual,
        )


def index_rows(folder: Path, names: NDArray[np.int64]) -> RowImages:
    """Index images by their names (N,): the first and the last that can be read are, whatever their number.

    An image is named after an instant of its revolution: in Oxford the first azimuth, in Boreas the middle, in MulRan the
    end. The first image shows which; the others begin the same part of their turns before their names.

    Raises:
        DataError: no images, or half of them that cannot be used.
    """
    if not len(names):
        raise DataError(folder, "holds no revolutions", "it should hold images named <t>.png, t in microseconds")

    def opened(name: int) -> tuple[Flag, tuple[str, ...], Azimuths]:
        flag, notes = _flag(read_grey(folder / f"{name}.png"))
        return flag, notes, _read(folder, name, flag)[0]

    (flag, notes, azimuths), skipped, faults = first_readable(names.tolist(), opened, "first")
    names = names[skipped:]
    count, backward = len(azimuths.stamps_us), names[::-1].tolist()
    (last, _), skipped, missing = first_readable(backward, lambda name: _read(folder, name, flag, count), "last")
    names = names[: len(names) - skipped]
    named_us = in_us(names)
    known = {0: azimuths, len(names) - 1: last}
    usual = find_usual_turns(named_us, lambda k: _measured(folder, names, flag, k, known))
    before = place_turns(named_us, "end", usual)[1]
    before[0] = azimuths.turn_us or before[0]
    lead = int(named_us[0]) - int(azimuths.stamps_us[0])
    within = 0 <= lead <= before[0]
    starts = named_us - (np.round(lead * before / before[0]).astype(np.int64) if within else lead)
    turns = place_turns(starts, "start", usual)[1]
    if last.turn_us is not None:
        turns[-1] = max(1, int(last.stamps_us[0]) + last.turn_us - int(starts[-1]))
    return RowImages(folder, names, starts, turns, flag, count, notes, (*faults, *missing))


def _measured(folder: Path, names: NDArray[np.int64], flag: Flag, k: int, known: dict[int, Azimuths]) -> float | None:
    """How long the turn of image k took by its azimuths' stamps [us], or None where they cannot be read or do not say."""
    try:
        azimuths = known[k] if k in known else _read(folder, int(names[k]), flag)[0]
    except DataError:
        return None
    return azimuths.measured_turn_us


def _flag(pixels: NDArray[np.uint8]) -> tuple[Flag, tuple[str, ...]]:
    """What byte 10 tells in a recording, seen from its first image (A, 11 + B), and a note where that is not validity.

    Few rows of a recording are marked as not measured. Boreas leaves the byte unused, Boreas-RT puts the direction of the
    chirp there, which alternates from row to row.
    """
    if pixels.shape[1] <= METADATA_BYTES:
        return Flag.VALIDITY, ()
    share = float(np.mean(pixels[:, FLAG_BYTE] == 255))
    if share > 0.75:
        return Flag.VALIDITY, ()
    if share > 0.25:
        return Flag.CHIRP, (
            f"byte 10 is 255 in {share:.0%} of the rows: taken as the direction of the chirp (Boreas-RT), whose Doppler "
            "shifts have opposite signs, so only the up-chirps (255) are used",
        )
    return Flag.NOTHING, (
        f"byte 10 is 255 in {share:.0%} of the rows: taken as unused or as down-chirps (Boreas-RT, where doppler_beta is "
        "below zero), not as azimuths that were not measured",
    )


def _read(folder: Path, name: int, flag: Flag, usual: int = 0) -> tuple[Azimuths, NDArray[np.uint8]]:
    """The azimuths of an image and their power (A, B), once they have been found to belong to its name.

    A revolution may lack azimuths, but hardly all of them.

    Args:
        usual: number of azimuths of the recording's other images.
    """
    image = folder / f"{name}.png"
    pixels = read_grey(image)
    try:
        azimuths = read_metadata(pixels, flags_validity=flag is Flag.VALIDITY)
        if flag is Flag.CHIRP:
            up = pixels[:, FLAG_BYTE] == 255
            azimuths, pixels = azimuths.take(up), pixels[up]
            if len(pixels) < 2:
                raise ValueError(f"has {len(pixels)} up-chirps")
        if len(pixels) < _FEWEST_AZIMUTHS * usual:
            raise ValueError(f"has {len(pixels)} azimuths, the first image {usual}")
    except ValueError as error:
        raise DataError(image, str(error), _REMEDY) from error
    apart = int(azimuths.stamps_us[0]) - int(in_us(np.asarray(name)))
    span = int(azimuths.stamps_us[-1]) - int(azimuths.stamps_us[0])
    if not -span - _MOST_STAMP_ERROR_US <= apart <= _MOST_STAMP_ERROR_US:
        raise DataError(image, f"its first row is stamped {apart * 1e-6:.1f} s after its name", _REMEDY)
    return azimuths, pixels[:, METADATA_BYTES:]
