"""Gyroscopes as CSV with the header `t,wx,wy,wz`: `imu.csv` beside a recording in Oxford's form, or a user's own file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.sensors.fixes import Fixes
from mqslam.core.sensors.gyroscope import Gyroscope
from mqslam.core.sensors.mount import Mount
from mqslam.core.wording import count_of
from mqslam.errors import DataError, untrusted
from mqslam.execution.files import write_text
from mqslam.formats.sensors.reading import Reading, make_fixes, make_gyroscope
from mqslam.formats.tables import DEGREES, RATES, Header, SensorTable, read_converted, read_header, read_sensor_table

GYROSCOPE_REMEDY = "give a CSV whose header is t,wx,wy,wz: microseconds, and rad/s about x forward, y left and z up"
FIXES_REMEDY = "give an NMEA log, or a CSV whose header is t,lat,lon[,sigma_m]: microseconds, degrees and metres"
TO_FORWARD = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Takes vectors of the Applanix frame to x forward, y left, z up."""
_SQUARE = 1e-3  # the rows of a rotation in a file are of unit length and square to one another within this
APPLANIX_COLUMN = "angvel_z"
DMU_NAMES = ("dmu_imu.csv", "dmu_imu_infilled.csv")
_RAW_NAME, _POST_PROCESSED_NAME = "imu_raw.csv", "imu.csv"
_APPLANIX_FROM_RAW = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_APPLANIX_FROM_DMU = np.diag([1.0, -1.0, -1.0])  # where T_applanix_dmu.txt is missing; the files differ by a degree from it
_BOREAS_IMU = "give one of the IMU files of a Boreas recording"
TIME = "gpstime"
_PLACE = ("latitude", "longitude")
_BOREAS_FIXES = "give a file of a Boreas recording whose header names GPSTime, latitude and longitude"
IMU_NAME, GPS_NAME = "xsens_imu.csv", "gps.csv"
_IMU_COLUMNS = 17  # stamp, quaternion 4, Euler angles 3, rates 3, accelerations 3, magnetic field 3
_RATES = (8, 9, 10)
_GPS_COLUMNS = 13  # stamp, latitude, longitude, altitude, position covariance 9
_MULRAN_PLACE, _VARIANCES = (1, 2), (4, 8)  # latitude and longitude; variance along east and along north
STATUS = "ins_status"
_GOOD = "SOLUTION_GOOD"
_LONGEST_STEP_US = 1_000_000  # a heading may turn by half a turn in a longer time, and its difference would be ambiguous
_OXFORD_INS = "give gps/ins.csv or gps/gps.csv as the Oxford RobotCar dataset has them"


def read_gyroscope_csv(header: Header) -> Reading[Gyroscope]:
    """Reads a gyroscope from a CSV: t in us, wx, wy and wz in rad/s about x forward, y left, z up.

    Args:
        header: the first line of the file.

    Raises:
        DataError: a column is missing, or fewer than two rows can be used.
    """
    table = read_converted(header, [(name, RATES) for name in ("wx", "wy", "wz")], GYROSCOPE_REMEDY)
    return make_gyroscope(header.path, str(header.path), table)


def write_gyroscope_csv(path: Path, gyroscope: Gyroscope) -> None:
    """Writes a gyroscope as `t,wx,wy,wz` [us, rad/s]."""
    lines = ["t,wx,wy,wz"]
    for stamp, (x, y, z) in zip(gyroscope.stamps_us.tolist(), gyroscope.rates.tolist(), strict=True):
        lines.append(f"{stamp},{x:.12g},{y:.12g},{z:.12g}")
    write_text(path, "\n".join(lines) + "\n")


def read_fixes_csv(header: Header, *, made_truth: bool = False) -> Reading[Fixes]:
    """Reads fixes from a CSV: t in us, lat and lon in degrees and, where the receiver states it, sigma_m in m.

    Args:
        header: the first line of the file.
        made_truth: whether the recording's ground truth was made from them.

    Raises:
        DataError: a column is missing, or no row can be used.
    """
    stated = [("sigma_m", {"m": 1.0})] if "sigma_m" in header.names else []
    table = read_converted(header, [("lat", DEGREES), ("lon", DEGREES), *stated], FIXES_REMEDY)
    if table.columns.shape[1] < 3:
        table = table.with_columns(np.column_stack([table.columns, np.full(len(table.columns), np.nan)]))
    return make_fixes(header.path, str(header.path), table, made_truth=made_truth)


def write_fixes_csv(path: Path, fixes: Fixes) -> None:
    """Writes fixes as `t,lat,lon,sigma_m` [us, degrees, m]; sigma_m is empty where the receiver states none."""
    lines = ["t,lat,lon,sigma_m"]
    for stamp, latitude, longitude, sigma in zip(
        fixes.stamps_us.tolist(), fixes.latitudes.tolist(), fixes.longitudes.tolist(), fixes.sigmas_m.tolist(), strict=True
    ):
        lines.append(f"{stamp},{latitude:.10f},{longitude:.10f},{'' if np.isnan(sigma) else f'{sigma:.12g}'}")
    write_text(path, "\n".join(lines) + "\n")


@untrusted.reads_file
def read_boreas_mount(calibration: Path) -> Mount | None:
    """Reads the pose of the radar in the Applanix frame, or returns None where the calibrations do not state it.

    Args:
        calibration: the folder `calib`.

    Raises:
        DataError: a file is no transform.
    """
    direct = calibration / "T_applanix_radar.txt"
    to_lidar, from_lidar = calibration / "T_applanix_lidar.txt", calibration / "T_radar_lidar.txt"
    if direct.exists():
        matrix, source = read_transform(direct), str(direct)
    elif to_lidar.exists() and from_lidar.exists():
        matrix = read_transform(to_lidar) @ np.linalg.inv(read_transform(from_lidar))
        source = f"{to_lidar} and {from_lidar.name}"
    else:
        return None
    x, y, _ = TO_FORWARD @ matrix[:3, 3]
    ahead = TO_FORWARD @ matrix[:3, 0]
    return Mount(np.array([x, y, np.arctan2(ahead[1], ahead[0])]), source)


def read_transform(file: Path) -> NDArray[np.float64]:
    """Reads a transform (4, 4) of points.

    Raises:
        DataError: the file holds none.
    """
    try:
        with untrusted.open_text(file) as lines:
            matrix = np.loadtxt(lines, ndmin=2)
        turn = matrix[:3, :3]
        if (
            matrix.shape != (4, 4)
            or not np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0))
            or not np.isfinite(matrix).all()
            or np.abs(turn @ turn.T - np.eye(3)).max() > _SQUARE
        ):
            raise ValueError("its rows are no rotation and translation")
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise DataError(file, f"is no transform of four rows and columns ({reason})", "repair or remove it") from error
    return matrix


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
    header = read_header(file, _BOREAS_IMU)
    if file.name in DMU_NAMES:
        table = read_sensor_table(header, header.find(("time", "wx", "wy", "wz"), _BOREAS_IMU))
        turn, note = _find_dmu_turn(file)
    else:
        table = read_sensor_table(header, header.find(("gpstime", "angvel_x", "angvel_y", "angvel_z"), _BOREAS_IMU))
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


def find_boreas_fixes(root: Path) -> Header | None:
    """Returns the header of the file of the fixes, or None where no file names latitude and longitude.

    Raises:
        DataError: a file is there, but is no text.
    """
    for name in ("gps_post_process.csv", "gps.csv"):
        file = root / "applanix" / name
        if file.exists() and {TIME, *_PLACE} <= set((header := read_header(file, _BOREAS_FIXES)).names):
            return header
    return None


def read_boreas_fixes(header: Header) -> Reading[Fixes]:
    """Reads the fixes, from which the dataset's ground truth was made.

    Angles are radians in the dataset; those too large for radians are degrees.

    Args:
        header: the first line of the file.

    Raises:
        DataError: a column is missing, or no row can be used.
    """
    table = read_sensor_table(header, header.find((TIME, *_PLACE), _BOREAS_FIXES))
    largest = np.nanmedian(np.abs(table.columns), axis=0) if np.isfinite(table.columns).any(axis=0).all() else np.zeros(2)
    in_radians = bool(largest[0] <= np.pi / 2 and largest[1] <= np.pi)
    degrees = np.rad2deg(table.columns) if in_radians else table.columns
    columns = np.column_stack([degrees, np.full(len(degrees), np.nan)])
    note = f"latitudes and longitudes in {header.path} are taken as {'radians' if in_radians else 'degrees'}"
    return make_fixes(header.path, str(header.path), table.with_columns(columns), note, made_truth=True)


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
    _require_columns(header, _IMU_COLUMNS, GYROSCOPE_REMEDY)
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
    _require_columns(header, _GPS_COLUMNS, FIXES_REMEDY)
    table = read_sensor_table(header, (0, *_MULRAN_PLACE, *_VARIANCES))
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


def read_ins_rates(header: Header) -> Reading[Gyroscope]:
    """Reads the rates of the INS: the difference quotients of its attitude, halfway between two rows, since it states none.

    Only rows count whose status is good, and only two that follow each other in the file. The rates about x and y are those
    of roll and pitch, as long as these are small.

    Args:
        header: the first line of ins.csv.

    Raises:
        DataError: a column is missing, or fewer than two rows can be used.
    """
    table, notes = _read_good_rows(header, ("roll", "pitch", "yaw"))
    steps_us = np.diff(table.stamps_us)
    turns = se2.wrap(np.diff(table.columns[:, 1:], axis=0)) * [1.0, -1.0, -1.0]  # from x, y right, z down
    near = (steps_us > 0) & (steps_us <= _LONGEST_STEP_US)
    near &= np.isfinite(table.columns[:-1, 0]) & np.isfinite(table.columns[1:, 0])  # both are good
    rates = turns[near] / (steps_us[near, None] * 1e-6)
    middles = table.stamps_us[:-1][near] + steps_us[near] // 2
    source = f"the heading in {header.path}, differentiated"
    return make_gyroscope(header.path, source, SensorTable(middles, rates, table.unread), *notes)


def read_ins_fixes(header: Header) -> Reading[Fixes]:
    """Reads the fixes of the INS or, from gps.csv, those of its receiver with their standard deviations.

    The dataset's ground truth is made with them.

    Args:
        header: the first line of ins.csv or gps.csv.

    Raises:
        DataError: a column is missing, or no row can be used.
    """
    places, sigmas = ("latitude", "longitude"), ("latitude_sigma", "longitude_sigma")
    if STATUS in header.names:
        table, notes = _read_good_rows(header, places)
        good = np.isfinite(table.columns[:, 0])
        columns = np.column_stack([table.columns[good, 1:], np.full(np.count_nonzero(good), np.nan)])
        table = SensorTable(table.stamps_us[good], columns, table.unread)
    else:
        notes = []
        wanted = (*places, *sigmas) if set(sigmas) <= set(header.names) else places
        table = read_sensor_table(header, header.find(("timestamp", *wanted), _OXFORD_INS))
        spread = np.sqrt(np.mean(table.columns[:, 2:] ** 2, axis=1)) if len(wanted) > 2 else np.nan
        table = table.with_columns(np.column_stack([table.columns[:, :2], np.broadcast_to(spread, len(table.columns))]))
    return make_fixes(header.path, str(header.path), table, *notes, made_truth=True)


def _read_good_rows(header: Header, names: Sequence[str]) -> tuple[SensorTable, list[str]]:
    """Reads whether the status of each row is good (1, else NaN) and some columns, with a note on those that are not."""
    columns = header.find(("timestamp", STATUS, *names), _OXFORD_INS)
    table = read_sensor_table(header, columns, "", {columns[1]: _parse_status})
    bad = int(np.count_nonzero(~np.isfinite(table.columns[:, 0])))
    rows = count_of(len(table.columns), "row")
    return table, [f"{bad} of {rows} in {header.path} are left out: their {STATUS} is not {_GOOD}"] if bad else []


def _parse_status(text: str) -> float:
    """Returns 1 for a good status, NaN for others."""
    return 1.0 if text.strip().endswith(_GOOD) else float("nan")
