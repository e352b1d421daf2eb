"""The sensors of MulRan's car: `xsens_imu.csv` and `gps.csv`, tables without a header and with stamps in ns.

Source: github.com/RPM-Robotics-Lab/file_player_mulran, src/ROSThread.cpp, for the columns. The dataset does not say how the
IMU is turned. Its makers point to the Complex Urban dataset, whose car and sensors are almost the same (issue 27 there): its
Vehicle2IMU.txt has the vehicle's own axes, x forward, y left, z up.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mqslam.core.sensors import Fixes, Gyroscope
from mqslam.errors import DataError
from mqslam.formats.sensors import fixes_csv, gyroscope_csv
from mqslam.formats.sensors.reading import Reading, make_fixes, make_gyroscope
from mqslam.formats.sensors.sensor_table import Header, read_sensor_table

IMU_NAME, GPS_NAME = "xsens_imu.csv", "gps.csv"
_IMU_COLUMNS = 17  # stamp, quaternion 4, Euler angles 3, rates 3, accelerations 3, magnetic field 3
_RATES = (8, 9, 10)
_GPS_COLUMNS = 13  # stamp, latitude, longitude, altitude, position covariance 9
_PLACE, _VARIANCES = (1, 2), (4, 8)  # latitude and longitude; variance along east and along north


def find_mulran_file(images: Path, name: str) -> Path | None:
    """Returns the file of a name in the folders above that of the images, or None where there is none."""
    return next((file for above in images.resolve().parents[:3] if (file := above / name).exists()), None)


def read_mulran_imu(header: Header) -> Reading[Gyroscope]:
    """Reads the rates of the Xsens.

    Args:
        header: the first line of xsens_imu.csv.

    Raises:
        DataError: the file has no rates, as in the first version of the dataset, or fewer than two rows can be used.
    """
    _require_columns(header, _IMU_COLUMNS, gyroscope_csv.REMEDY)
    table = read_sensor_table(header, (0, *_RATES))
    note = f"the axes of {header.path} are taken as those of the vehicle"
    return make_gyroscope(header.path, str(header.path), table, note)


def read_mulran_fixes(header: Header) -> Reading[Fixes]:
    """Reads the fixes of the receiver, which had a part in the dataset's ground truth.

    Args:
        header: the first line of gps.csv.

    Raises:
        DataError: columns are missing, or no row can be used.
    """
    _require_columns(header, _GPS_COLUMNS, fixes_csv.REMEDY)
    table = read_sensor_table(header, (0, *_PLACE, *_VARIANCES))
    spread = np.sqrt(np.maximum(table.columns[:, 2:].mean(axis=1), 0.0))
    columns = np.column_stack([table.columns[:, :2], spread])
    return make_fixes(header.path, str(header.path), table.with_columns(columns), made_truth=True)


def _require_columns(header: Header, count: int, remedy: str) -> None:
    """Raises DataError unless a table has at least as many columns.

    Args:
        header: the first line of the table, which holds numbers already.
        count: columns of MulRan's file.
        remedy: what a user can do whose file is not MulRan's.
    """
    if len(header.names) < count:
        remedy = f"{remedy}; or one of {count} columns without a header, as MulRan's later versions have it"
        raise DataError(header.path, f"has {len(header.names)} columns in its first line", remedy)
