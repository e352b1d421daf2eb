"""The sensors of RADIATE's car: `GPS_IMU_Twist/000001.txt`, one file per message, with stamps in `GPS_IMU_Twist.txt`.

The first line of a file is latitude, longitude [degrees] and altitude; three lines are the covariance of the position along
east, north and up [m^2]; then come the orientation and, in the sixth line, the turn rates about x forward, y right and z
down [rad/s]. Every message is there twice, with the same stamp. The clock is not that of the radar.

Source: github.com/marcelsheeny/radiate_sdk, README.md, for the files; their order and axes were found on a drive.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mqslam.core.sensors.fixes import Fixes
from mqslam.core.sensors.gyroscope import Gyroscope
from mqslam.errors import DataError, untrusted
from mqslam.formats.sensors.reading import Reading, make_fixes, make_gyroscope
from mqslam.formats.sensors.sensor_table import SensorTable
from mqslam.formats.shared.stamps import format_frame, read_listing

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
