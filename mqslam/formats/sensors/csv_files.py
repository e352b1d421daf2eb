"""Reads gyroscopes and GNSS fixes from mqslam's own CSV and from tables of Boreas, Oxford and MulRan; writes its own CSV.

Sources and axes:

- Boreas and Boreas-RT (github.com/utiasASRL/pyboreas, DATA_REFERENCE.md, DATA_RT_REFERENCE.md and issue 44): the Applanix
  frame, and so imu.csv, is x right, y forward, z up. The Applanix IMU, and so imu_raw.csv, is x backward, y left; the issue
  says z up, which would be left-handed: z is down, as `T_imu_applanix` in github.com/utiasASRL/boreas_vtr_wrapper has it.
  The axes of Boreas-RT's DMU41, about x right, y backward, z down, are given by `calib/T_applanix_dmu.txt`.
- Oxford's INS, a NovAtel SPAN-CPT (robotcar-dataset.robots.ox.ac.uk/documentation): roll, pitch and yaw turn x forward, y
  right, z down into north, east, down [rad]; stamps are in us.
- MulRan's Xsens (github.com/RPM-Robotics-Lab/file_player_mulran, src/ROSThread.cpp, for the columns): the dataset does not
  state its axes. Its makers point to the Complex Urban dataset, whose car and sensors are almost the same (issue 27 there).
  By that dataset's Vehicle2IMU.txt the axes are the vehicle's: x forward, y left, z up. MulRan's tables have no header, and
  stamps in ns.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.sensors import Fixes, Gyroscope
from mqslam.core.wording import count_of
from mqslam.errors import DataError, untrusted
from mqslam.execution.files import write_text
from mqslam.formats.sensors.reading import Reading, make_fixes, make_gyroscope
from mqslam.formats.tables import DEGREES, RATES, Header, SensorTable, read_converted_sensor, read_header, read_sensor_table

GYROSCOPE_REMEDY = "give a CSV whose header is t,wx,wy,wz: microseconds, and rad/s about x forward, y left and z up"
FIXES_REMEDY = "give an NMEA log, or a CSV whose header is t,lat,lon[,sigma_m]: microseconds, degrees and metres"
DMU_NAMES = ("dmu_imu.csv", "dmu_imu_infilled.csv")
TO_FORWARD = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rotation (3, 3) of vectors from the Applanix frame to x forward, y left, z up."""
_SQUARE = 1e-3  # the rows of a rotation in a file have unit length and are at right angles within this
_APPLANIX_FROM_RAW = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_APPLANIX_FROM_DMU = np.diag([1.0, -1.0, -1.0])  # where T_applanix_dmu.txt is missing; such files differ from it by a degree
_BOREAS_IMU = "give one of the IMU files of a Boreas recording"
_BOREAS_FIXES = "give a file of a Boreas recording whose header names GPSTime, latitude and longitude"
_OXFORD_INS = "give gps/ins.csv or gps/gps.csv as the Oxford RobotCar dataset has them"
_STATUS, _GOOD = "ins_status", "SOLUTION_GOOD"
_LONGEST_STEP_US = 1_000_000  # in a longer time the heading may change by 180 degrees, so its difference is ambiguous
# indices from 0 of columns: stamp and rates; stamp, latitude, longitude and variances along east and north
_MULRAN_RATES, _MULRAN_PLACE = (0, 8, 9, 10), (0, 1, 2, 4, 8)
_MULRAN_COLUMNS = (17, 13)  # how many columns the tables of the gyroscope and of the fixes have


@untrusted.reads_file
def read_gyroscope_table(path: Path) -> Reading[Gyroscope]:
    """Reads a gyroscope from a CSV `t,wx,wy,wz` in us and rad/s unless the header states units, or a dataset's table.

    The rates are about x forward, y left, z up. The tables are those of Oxford, Boreas and MulRan.

    Raises:
        DataError: the file cannot be read, has none of these forms, or holds fewer than two rows that can be used.
    """
    header = read_header(path, GYROSCOPE_REMEDY)
    if path.name in DMU_NAMES or "angvel_z" in header.names:
        return _read_boreas_rates(header)
    if _STATUS in header.names:
        return _read_ins_rates(header)
    if header.holds_numbers:
        table = _read_mulran_table(header, _MULRAN_RATES, _MULRAN_COLUMNS[0], GYROSCOPE_REMEDY)
        return make_gyroscope(path, table, f"the axes of {path} are taken as those of the vehicle")
    return make_gyroscope(
        path, read_converted_sensor(header, [(name, RATES) for name in ("wx", "wy", "wz")], GYROSCOPE_REMEDY)
    )


@untrusted.reads_file
def read_fixes_table(path: Path, *, made_truth: bool = False) -> Reading[Fixes]:
    """Reads GNSS fixes from a CSV: `t,lat,lon[,sigma_m]`, or a table of Oxford, Boreas or MulRan.

    Args:
        path: the file.
        made_truth: whether the recording's ground truth was made from these fixes; always true for tables of the datasets.

    Raises:
        DataError: the file cannot be read, has none of these forms, or holds no fix.
    """
    header = read_header(path, FIXES_REMEDY)
    if "latitude" in header.names or _STATUS in header.names:
        return _read_boreas_fixes(header) if "gpstime" in header.names else _read_ins_fixes(header)
    if header.holds_numbers:
        table = _read_mulran_table(header, _MULRAN_PLACE, _MULRAN_COLUMNS[1], FIXES_REMEDY)
        sigmas = np.sqrt(np.maximum(table.columns[:, 2:].mean(axis=1), 0.0))
        return make_fixes(path, table.with_columns(table.columns[:, :2], sigmas), made_truth=True)
    stated = [("sigma_m", {"m": 1.0})] if "sigma_m" in header.names else []
    table = read_converted_sensor(header, [("lat", DEGREES), ("lon", DEGREES), *stated], FIXES_REMEDY)
    return make_fixes(path, table, made_truth=made_truth)


def write_gyroscope_csv(path: Path, gyroscope: Gyroscope) -> None:
    """Writes a gyroscope as `t,wx,wy,wz` [us, rad/s], about x forward, y left and z up."""
    lines = ["t,wx,wy,wz"]
    for stamp, (x, y, z) in zip(gyroscope.stamps_us.tolist(), gyroscope.rates.tolist(), strict=True):
        lines.append(f"{stamp},{x:.12g},{y:.12g},{z:.12g}")
    write_text(path, "\n".join(lines) + "\n")


def write_fixes_csv(path: Path, fixes: Fixes) -> None:
    """Writes fixes as `t,lat,lon,sigma_m` [us, degrees, m]; sigma_m is empty where the receiver states none."""
    lines = ["t,lat,lon,sigma_m"]
    for stamp, latitude, longitude, sigma in zip(
        fixes.stamps_us.tolist(), fixes.latitudes.tolist(), fixes.longitudes.tolist(), fixes.sigmas_m.tolist(), strict=True
    ):
        lines.append(f"{stamp},{latitude:.10f},{longitude:.10f},{'' if np.isnan(sigma) else f'{sigma:.12g}'}")
    write_text(path, "\n".join(lines) + "\n")


def read_transform(file: Path) -> NDArray[np.float64]:
    """Reads a calibration file of Boreas: `T_a_b.txt` holds the transform (4, 4) of points [m] from frame b to frame a.

    Raises:
        DataError: the file cannot be read, or does not hold a rotation and a translation in four rows and columns.
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


def _read_boreas_rates(header: Header) -> Reading[Gyroscope]:
    """Reads one of the gyroscopes of Boreas, and rotates its rates to axes x forward, y left, z up."""
    file = header.path
    if file.name in DMU_NAMES:
        names = ("time", "wx", "wy", "wz")
        turn, note = _find_dmu_turn(file)
    else:
        names = ("gpstime", "angvel_x", "angvel_y", "angvel_z")
        raw = file.name == "imu_raw.csv"
        turn = _APPLANIX_FROM_RAW if raw else np.eye(3)
        note = f"the axes of {file} are taken as " + ("x backward, y left, z down" if raw else "x right, y forward, z up")
    table = read_sensor_table(header, header.find(names, _BOREAS_IMU))
    with np.errstate(invalid="ignore"):  # rates that are not finite are left out afterwards
        return make_gyroscope(file, table.with_columns(table.columns @ (TO_FORWARD @ turn).T), note)


def _find_dmu_turn(file: Path) -> tuple[NDArray[np.float64], str]:
    """Returns the rotation (3, 3) from the DMU41's axes to the Applanix frame, and a note for the user on its source."""
    calibration = file.parent.parent / "calib" / "T_applanix_dmu.txt"
    if calibration.exists():
        return read_transform(calibration)[:3, :3], f"the axes of {file} are rotated by {calibration.name}"
    return _APPLANIX_FROM_DMU, f"the axes of {file} are taken as x right, y backward, z down: there is no {calibration}"


def _read_boreas_fixes(header: Header) -> Reading[Fixes]:
    """Reads the fixes of Boreas: their angles are radians, or degrees if the median latitude or longitude is too large."""
    table = read_sensor_table(header, header.find(("gpstime", "latitude", "longitude"), _BOREAS_FIXES))
    largest = np.nanmedian(np.abs(table.columns), axis=0) if np.isfinite(table.columns).any(axis=0).all() else np.zeros(2)
    in_radians = bool(largest[0] <= np.pi / 2 and largest[1] <= np.pi)
    degrees = np.rad2deg(table.columns) if in_radians else table.columns
    note = f"latitudes and longitudes in {header.path} are taken as {'radians' if in_radians else 'degrees'}"
    return make_fixes(header.path, table.with_columns(degrees), note, made_truth=True)


def _read_ins_rates(header: Header) -> Reading[Gyroscope]:
    """Computes rates from the attitude of Oxford's INS: differences between successive rows, with stamps in the middle.

    Both rows must have a good status and be at most 1 s apart. The rates of roll and pitch are taken as the rates about x
    and y, which is right as long as both angles are small.
    """
    table, notes = _read_good_rows(header, ("roll", "pitch", "yaw"))
    steps_us = np.diff(table.stamps_us)
    turns = se2.wrap(np.diff(table.columns[:, 1:], axis=0)) * [1.0, -1.0, -1.0]  # from y right and z down to y left and z up
    near = (steps_us > 0) & (steps_us <= _LONGEST_STEP_US)
    near &= np.isfinite(table.columns[:-1, 0]) & np.isfinite(table.columns[1:, 0])  # the status of both rows is good
    rates = turns[near] / (steps_us[near, None] * 1e-6)
    middles = table.stamps_us[:-1][near] + steps_us[near] // 2
    source = f"the heading in {header.path}, differentiated"
    return make_gyroscope(header.path, SensorTable(middles, rates, table.unread), *notes, source=source)


def _read_ins_fixes(header: Header) -> Reading[Fixes]:
    """Reads the fixes of Oxford's INS or, from gps.csv, those of its GNSS receiver, with standard deviations if stated."""
    places, sigmas = ("latitude", "longitude"), ("latitude_sigma", "longitude_sigma")
    notes: list[str] = []
    if _STATUS in header.names:
        table, notes = _read_good_rows(header, places)
        good = np.isfinite(table.columns[:, 0])
        table = SensorTable(table.stamps_us[good], table.columns[good, 1:], table.unread)
    else:
        wanted = (*places, *sigmas) if set(sigmas) <= set(header.names) else places
        table = read_sensor_table(header, header.find(("timestamp", *wanted), _OXFORD_INS))
        if len(wanted) > 2:
            table = table.with_columns(table.columns[:, :2], np.sqrt(np.mean(table.columns[:, 2:] ** 2, axis=1)))
    return make_fixes(header.path, table, *notes, made_truth=True)


def _read_good_rows(header: Header, names: Sequence[str]) -> tuple[SensorTable, list[str]]:
    """Reads the status (1 in a good row, else NaN) and the named columns; also returns a note on rows that are not good."""
    columns = header.find(("timestamp", _STATUS, *names), _OXFORD_INS)
    table = read_sensor_table(
        header, columns, "", {columns[1]: lambda text: 1.0 if text.strip().endswith(_GOOD) else np.nan}
    )
    bad = int(np.count_nonzero(~np.isfinite(table.columns[:, 0])))
    rows = count_of(len(table.columns), "row")
    return table, [f"{bad} of {rows} in {header.path} are left out: their {_STATUS} is not {_GOOD}"] if bad else []


def _read_mulran_table(header: Header, columns: Sequence[int], count: int, remedy: str) -> SensorTable:
    """Reads the columns with given indices, the stamps first, of a table without a header.

    Raises:
        DataError: the table has fewer than `count` columns.
    """
    if len(header.names) < count:
        remedy = f"{remedy}; or a table of {count} columns without a header, as later versions of MulRan have it"
        raise DataError(header.path, f"has {len(header.names)} columns in its first line", remedy)
    return read_sensor_table(header, columns)
