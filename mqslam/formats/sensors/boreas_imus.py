"""The gyroscopes of Boreas and Boreas-RT: `applanix/imu_raw.csv`, `imu/dmu_imu.csv` and `applanix/imu.csv`.

Source: github.com/utiasASRL/pyboreas, DATA_REFERENCE.md, DATA_RT_REFERENCE.md and issue 44. Axes of

- the Applanix frame, and so of imu.csv: x right, y forward, z up;
- the Applanix IMU, and so of imu_raw.csv: x backward, y left. The issue says z up, which would be left-handed; it is down,
  as `T_imu_applanix` in github.com/utiasASRL/boreas_vtr_wrapper has it;
- the DMU41 of Boreas-RT: `calib/T_applanix_dmu.txt`, about x right, y backward, z down.

What imu.csv holds in Boreas is the post-processed solution, which the ground truth is, too; in Boreas-RT its authors advise
against it for the same reason. So it is read only where a user names it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core.sensors import Gyroscope
from mqslam.formats.sensors.boreas_mount import TO_FORWARD, read_transform
from mqslam.formats.sensors.reading import Reading, make_gyroscope
from mqslam.formats.sensors.sensor_table import read_header, read_sensor_table

APPLANIX_COLUMN = "angvel_z"
DMU_NAMES = ("dmu_imu.csv", "dmu_imu_infilled.csv")
_RAW_NAME, _POST_PROCESSED_NAME = "imu_raw.csv", "imu.csv"
_APPLANIX_FROM_RAW = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_APPLANIX_FROM_DMU = np.diag([1.0, -1.0, -1.0])  # where T_applanix_dmu.txt is missing; the files differ by a degree from it
_REMEDY = "give one of the IMU files of a Boreas recording"


def find_boreas_imu(root: Path) -> Path | None:
    """Returns the file of the gyroscope that a recording's ground truth depends on least, or None where there is none."""
    files = (*(root / "imu" / name for name in DMU_NAMES), root / "applanix" / _RAW_NAME)
    return next((file for file in files if file.exists()), None)


def note_unread_imu(root: Path) -> list[str]:
    """Notes that a recording has the post-processed gyroscope only, which is not taken of itself."""
    file = root / "applanix" / _POST_PROCESSED_NAME
    if find_boreas_imu(root) is not None or not file.exists():
        return []
    return [f"{file} comes out of the solution that the ground truth is, and is not read as a gyroscope; name it to use it"]


def read_boreas_imu(file: Path) -> Reading[Gyroscope]:
    """Reads a gyroscope, its rates turned to x forward, y left, z up.

    Raises:
        DataError: a column is missing, fewer than two rows can be used, or the calibration beside them is none.
    """
    header = read_header(file, _REMEDY)
    if file.name in DMU_NAMES:
        table = read_sensor_table(header, header.find(("time", "wx", "wy", "wz"), _REMEDY))
        turn, note = _find_dmu_turn(file)
    else:
        table = read_sensor_table(header, header.find(("gpstime", "angvel_x", "angvel_y", "angvel_z"), _REMEDY))
        raw = file.name == _RAW_NAME
        turn = _APPLANIX_FROM_RAW if raw else np.eye(3)
        note = f"the axes of {file} are taken as " + ("x backward, y left, z down" if raw else "x right, y forward, z up")
    with np.errstate(invalid="ignore"):  # rates that are not finite are left out afterwards
        rates = table.columns @ (TO_FORWARD @ turn).T
    return make_gyroscope(header.path, str(file), table.with_columns(rates), note)


def _find_dmu_turn(file: Path) -> tuple[NDArray[np.float64], str]:
    """Finds the rotation (3, 3) from the DMU41's axes to those of Applanix, and notes where it comes from."""
    calibration = file.parent.parent / "calib" / "T_applanix_dmu.txt"
    if calibration.exists():
        return read_transform(calibration)[:3, :3], f"the axes of {file} are turned by {calibration.name}"
    return _APPLANIX_FROM_DMU, f"the axes of {file} are taken as x right, y backward, z down: there is no {calibration}"
