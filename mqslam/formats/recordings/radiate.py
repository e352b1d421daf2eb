"""The layout RADIATE: `Navtech_Polar/000001.png`, one column per azimuth, with arrival stamps in `Navtech_Polar.txt`.

The readings of its sensors lie in `GPS_IMU_Twist/`.

The first line of a file of sensors is latitude, longitude [degrees] and altitude; three lines are the covariance of the
position along east, north and up [m^2]; then come the orientation and, in the sixth line, the turn rates about x forward,
y right and z down [rad/s]. Every message is there twice, with the same stamp. The clock is not that of the radar.

Source: github.com/marcelsheeny/radiate_sdk, README.md, for the files; their order and axes were found on a drive.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from mqslam.core.recording import Recording
from mqslam.core.sensors import NO_SENSORS, Fixes, Gyroscope
from mqslam.errors import DataError, untrusted
from mqslam.execution.files import write_text
from mqslam.execution.folders import write_folder_aside
from mqslam.formats.odometry_files import read_beside
from mqslam.formats.recordings.column_images import ColumnImageRecording, ColumnImages, open_columns, write_columns
from mqslam.formats.sensors.carried import Carried, read_carried
from mqslam.formats.sensors.reading import Reading, make_fixes, make_gyroscope
from mqslam.formats.sensors.sensor_table import SensorTable
from mqslam.formats.shared.images import list_numbers
from mqslam.formats.shared.sensing import Sensing
from mqslam.formats.shared.stamps import FRAME_DIGITS, format_frame, read_listing
from mqslam.formats.shared.target import Target

NAME = "GPS_IMU_Twist"
_PLACE, _EAST, _NORTH, _RATES = 0, 1, 2, 5  # lines: position, two rows of its covariance, turn rates
_MOST_BYTES = 10_000  # of a message, which has about 500
_DOWN = (1.0, -1.0, -1.0)  # from x forward, y right, z down to x forward, y left, z up


def read_radiate_messages(root: Path) -> SensorTable | None:
    """Reads the messages in a recording: latitude and longitude [degrees], standard deviation [m] and turn rates [rad/s].

    Args:
        root: the folder of the recording.

    Returns:
        The messages, of which one that cannot be read holds NaN; None where there are none.

    Raises:
        DataError: the list of stamps cannot be used.
    """
    folder = root / NAME
    if not folder.is_dir():
        return None
    frames, stamps = read_listing(root / f"{NAME}.txt")
    new = np.append(True, np.diff(stamps) != 0)[: len(stamps)]
    rows = [_read_message(folder / f"{format_frame(frame)}.txt") for frame in frames[new].tolist()]
    return SensorTable(stamps[new], np.array(rows).reshape(-1, 6))


def make_radiate_gyroscope(root: Path, messages: SensorTable) -> Reading[Gyroscope]:
    """Makes a gyroscope of the messages of a recording.

    Raises:
        DataError: fewer than two messages can be used.
    """
    note = f"the axes of {NAME} are taken as x forward, y right, z down"
    return make_gyroscope(root / NAME, NAME, messages.with_columns(messages.columns[:, 3:] * _DOWN), note, own_clock=True)


def make_radiate_fixes(root: Path, messages: SensorTable) -> Reading[Fixes]:
    """Makes fixes of the messages of a recording.

    Raises:
        DataError: no message can be used.
    """
    return make_fixes(root / NAME, NAME, messages.with_columns(messages.columns[:, :3]), own_clock=True)


def _read_message(file: Path) -> list[float]:
    """Reads latitude, longitude, standard deviation and three turn rates from a file; NaN where it cannot be read."""
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


_RADAR = "RADIATE's radar"
RANGE_RESOLUTION_M = 0.175  # of the CTS350-X as RADIATE uses it; 576 such bins reach 100.8 m
_OTHER_CLOCK = "GPS and IMU run on another clock, which a run finds: neither odometry nor ground truth is taken from them"


def recognises(path: Path) -> bool:
    """Returns whether the path holds a folder `Navtech_Polar`, or is that folder."""
    return _find_image_folder(path).is_dir()


def open_recording(path: Path, sensing: Sensing) -> ColumnImageRecording:
    """Indexes a recording of RADIATE: names, stamps and one image are read, however long it is.

    Args:
        path: the recording.
        sensing: what the user says about the radar.

    Raises:
        DataError: there are no polar scans, or a file cannot be used.
    """
    folder = _find_image_folder(path)
    if not folder.is_dir():
        raise DataError(path, "holds no folder Navtech_Polar/", "give the folder that holds it and Navtech_Polar.txt")
    listing = folder.parent / "Navtech_Polar.txt"
    frames, stamps = read_listing(listing)
    faults = []
    there = {int(name) for name in list_numbers(folder) if len(name) == FRAME_DIGITS}
    if unlisted := sorted(there - set(frames.tolist())):
        others = f" and {len(unlisted) - 1} others" if len(unlisted) > 1 else ""
        faults.append(f"{listing.name} has no line for frame {format_frame(unlisted[0])}{others}: left out")
    order = np.argsort(frames, kind="stable")
    if backward := np.flatnonzero(np.diff(frames) <= 0).tolist():
        faults.append(
            f"{listing.name} does not list its frames in order, first at {format_frame(frames[backward[0] + 1])}: sorted"
        )
    order = order[np.append(True, np.diff(frames[order]) > 0)[: len(order)]]
    present = order[np.isin(frames[order], list(there))]
    names, stamps = frames[present], stamps[present]
    missing = len(order) - len(names)
    skipped = [f"{missing} of {len(frames)} frames in {listing.name} have no image and are skipped"] if missing else []
    notes = (*skipped, *([_OTHER_CLOCK] if (folder.parent / NAME).exists() else []))
    images = ColumnImages(folder, names, FRAME_DIGITS)
    recording = open_columns(path, "radiate", images, stamps, names, (RANGE_RESOLUTION_M, _RADAR), sensing)
    recording = replace(recording, notes=(*notes, *recording.notes), faults=(*faults, *recording.faults))
    return _read_sensors(folder.parent).add_to(recording)


def _read_sensors(root: Path) -> Carried:
    """Reads the sensors of the recording in a folder."""
    messages, faults = read_beside(lambda: read_radiate_messages(root))
    if messages is None:
        return Carried(NO_SENSORS, (), tuple(faults))
    return read_carried(lambda: make_radiate_gyroscope(root, messages), lambda: make_radiate_fixes(root, messages))


def _find_image_folder(path: Path) -> Path:
    """Finds the folder of the images: the path itself if it is called Navtech_Polar, or the one inside."""
    return path.resolve() if path.resolve().name == "Navtech_Polar" else path / "Navtech_Polar"


def write(out: Path, recording: Recording) -> list[str]:
    """Writes a recording as a folder, whole or not at all, one polar scan in memory at a time.

    Returns:
        Notes for the user on what was lost.

    Raises:
        DataError: a polar scan cannot be read, or polar images cannot hold it.
        OutputError: the folder cannot be written.
    """
    names = [format_frame(number) for number in range(1, len(recording) + 1)]
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
