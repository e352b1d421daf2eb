"""Reads and writes the layout RADIATE: polar images `Navtech_Polar/000001.png` with one column per azimuth.

The stamps of arrival of the images lie in `Navtech_Polar.txt`, the readings of GPS and IMU in `GPS_IMU_Twist/`, one message
per file. The first line of a message is latitude, longitude [degrees] and altitude; the next three lines are the
covariance of the position along east, north and up [m^2]; the fifth is the orientation, and the sixth holds the turn rates
about x forward, y right and z down [rad/s]. Every message is stored twice, with the same stamp. The messages are stamped by
another clock than the images.

Source: github.com/marcelsheeny/radiate_sdk, README.md, for the files; the lines and axes were identified on a recording.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core.recording import Recording
from mqslam.core.wording import count_of
from mqslam.errors import DataError, untrusted
from mqslam.execution.files import write_text
from mqslam.execution.folders import write_folder_aside
from mqslam.formats.images import list_numbers
from mqslam.formats.recordings.column_images import ColumnImageRecording, ColumnImages, open_columns, write_columns
from mqslam.formats.recordings.layout import Sensing, Target
from mqslam.formats.sensors.reading import add_beside, make_fixes, make_gyroscope, read_beside
from mqslam.formats.tables import SensorTable, parse_times
from mqslam.formats.text import read_lines

_NAME = "GPS_IMU_Twist"
_PLACE, _EAST, _NORTH, _RATES = 0, 1, 2, 5  # indices of lines: position, two rows of its covariance, turn rates
_MOST_BYTES = 10_000  # largest size of a message; most have about 500
_DOWN = (1.0, -1.0, -1.0)  # signs that turn x forward, y right, z down into x forward, y left, z up
_DIGITS = 6  # least number of digits of a frame's number, in the list of stamps and in the name of the frame's file
_FRAME = re.compile(r"\s*Frame:\s*(\d{1,18})\s+Time:\s*(\d+)(?:\.(\d+))?\s*")
_LINE = "'Frame: 000001 Time: 1574859771.744660272'"
_NANOSECONDS = 9  # digits of a fraction of a second
RANGE_RESOLUTION_M = 0.175  # of the CTS350-X as RADIATE uses it; 576 such bins reach 100.8 m
_OTHER_CLOCK = "GPS and IMU run on another clock, whose offset a run finds: no odometry or ground truth is taken from them"


def recognises(path: Path) -> bool:
    """Returns whether a path contains a folder `Navtech_Polar`, or is this folder."""
    return _find_image_folder(path).is_dir()


def open_recording(path: Path, sensing: Sensing) -> ColumnImageRecording:
    """Indexes a recording of RADIATE: reads names and stamps of the images, one image, and the messages of GPS and IMU."""
    folder = _find_image_folder(path)
    if not folder.is_dir():
        raise DataError(path, "holds no folder Navtech_Polar/", "give the folder that holds it and Navtech_Polar.txt")
    listing = folder.parent / "Navtech_Polar.txt"
    frames, stamps = read_listing(listing)
    faults = []
    there = {int(name) for name in list_numbers(folder) if len(name) == _DIGITS}
    if unlisted := sorted(there - set(frames.tolist())):
        others = f" and {count_of(len(unlisted) - 1, 'other')}" if len(unlisted) > 1 else ""
        faults.append(f"{listing.name} has no line for frame {_format_frame(unlisted[0])}{others}: left out")
    order = np.unique(frames, return_index=True)[1]  # if a frame has several lines, the first counts
    if backward := np.flatnonzero(np.diff(frames) <= 0).tolist():
        faults.append(
            f"{listing.name} does not list its frames in order, first at {_format_frame(frames[backward[0] + 1])}: "
            "they are sorted"
        )
    present = order[np.isin(frames[order], list(there))]
    names, stamps = frames[present], stamps[present]
    missing = len(order) - len(names)
    skipped = [f"{missing} of {len(frames)} frames in {listing.name} have no image and are skipped"] if missing else []
    notes = (*skipped, *([_OTHER_CLOCK] if (folder.parent / _NAME).exists() else []))
    images = ColumnImages(folder, names, _DIGITS)
    bin_length = sensing.choose_resolution(RANGE_RESOLUTION_M, "RADIATE's radar")
    recording = open_columns(path, "radiate", images, stamps, names, bin_length, sensing)
    messages, unread = read_beside(lambda: _read_messages(folder.parent))
    faults, notes = [*faults, *recording.faults, *unread], (*notes, *recording.notes)
    recording = replace(recording, notes=notes, faults=tuple(faults))
    if messages is None:
        return recording
    sensors = folder.parent / _NAME
    rates = messages.with_columns(messages.columns[:, 3:] * _DOWN)
    places = messages.with_columns(messages.columns[:, :3])
    axes = f"the axes of {_NAME} are taken as x forward, y right, z down"
    return add_beside(
        recording,
        lambda: make_gyroscope(sensors, rates, axes, source=_NAME, own_clock=True),
        lambda: make_fixes(sensors, places, source=_NAME, own_clock=True),
    )


def read_listing(listing: Path) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Reads numbers of frames (N,) and stamps of arrival (N,) [us] from lines `Frame: 000001 Time: 1574859771.744660272`.

    RADIATE's files state the nanoseconds after the point without their leading zeros: `36.25327499` is 36 s and 25,327,499
    ns, not 36.25 s. If some lines have more digits after the point than others, the digits are read in two ways, as
    nanoseconds and as decimals, and the stamps with the more even steps are returned.

    Raises:
        DataError: the list cannot be read or is empty, or a line has another form.
    """
    remedy = f"it should hold a line {_LINE} for each file"
    lines = [line for line in read_lines(listing, remedy, missing=remedy) if line]
    if not lines:
        raise DataError(listing, "is empty", remedy)
    matches = [_FRAME.fullmatch(line) for line in lines]
    if None in matches:
        raise DataError(listing, f"line {matches.index(None) + 1} is not {_LINE}", "repair it")
    rows = [match.groups(default="0") for match in matches if match]
    fractions = [fraction for _, _, fraction in rows]
    padded = [fraction.rjust(_NANOSECONDS, "0") for fraction in fractions]
    choices = [fractions] if len({len(fraction) for fraction in fractions}) == 1 else [fractions, padded]
    seconds = [second for _, second, _ in rows]
    stamps = [parse_times(listing, [f"{s}.{f}" for s, f in zip(seconds, choice, strict=True)], "s") for choice in choices]
    frames = np.array([int(frame) for frame, _, _ in rows], dtype=np.int64)
    return frames, min(stamps, key=lambda some: float(np.abs(np.diff(some.astype(np.float64), 2)).sum()))


def _format_frame(frame: int) -> str:
    """Formats the number of a frame as the name of its file has it: with at least six digits."""
    return str(frame).zfill(_DIGITS)


def _read_messages(root: Path) -> SensorTable | None:
    """Reads the messages of GPS and IMU in the folder of a recording.

    Returns:
        One row (6,) per stamp: latitude, longitude [degrees], standard deviation [m] and the turn rates about x forward, y
        right, z down [rad/s]; a row of a damaged message is NaN. None if the recording has no folder of messages.
    """
    folder = root / _NAME
    if not folder.is_dir():
        return None
    frames, stamps = read_listing(root / f"{_NAME}.txt")
    new = np.append(True, np.diff(stamps) != 0)[: len(stamps)]
    rows = [_read_message(folder / f"{_format_frame(frame)}.txt") for frame in frames[new].tolist()]
    return SensorTable(stamps[new], np.array(rows).reshape(-1, 6))


def _read_message(file: Path) -> list[float]:
    """Reads a message from its file as a row (6,) of `_read_messages`; all numbers are NaN if the file is damaged."""
    try:
        lines = [
            [float(word) for word in line.split(",")] for line in untrusted.read_document(file, _MOST_BYTES).splitlines()
        ]
        latitude, longitude = lines[_PLACE][:2]
        variance = 0.5 * (lines[_EAST][0] + lines[_NORTH][1])
        x, y, z = lines[_RATES]
    except (OSError, ValueError, IndexError, DataError):
        return [float("nan")] * 6
    return [latitude, longitude, float(np.sqrt(max(variance, 0.0))), x, y, z]


def _find_image_folder(path: Path) -> Path:
    """Returns the path of the folder `Navtech_Polar`, which contains the images: the path itself, or a folder in it."""
    return path.resolve() if path.resolve().name == "Navtech_Polar" else path / "Navtech_Polar"


def write(out: Path, recording: Recording) -> list[str]:
    """Writes a recording as a folder, as `Target.write` describes it."""
    names = [_format_frame(number) for number in range(1, len(recording) + 1)]
    lines = [
        f"Frame: {name} Time: {end // 1_000_000}.{end % 1_000_000:06d}000\n"
        for name, end in zip(names, recording.ends_us.tolist(), strict=True)
    ]
    with write_folder_aside(out) as folder:
        write_text(folder / "Navtech_Polar.txt", "".join(lines))
        images = folder / "Navtech_Polar"
        images.mkdir()
        return write_columns(images, recording, names)


TARGETS = (Target("radiate", write, truth=False, validity=False, assumed_resolution=lambda _: RANGE_RESOLUTION_M),)
