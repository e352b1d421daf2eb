"""Gyroscopes, GNSS receivers and mounts: one module per format or dataset, and the choice among them for a file."""

from __future__ import annotations

from pathlib import Path

from mqslam.core.sensors import Fixes, Gyroscope
from mqslam.errors import DataError, untrusted
from mqslam.formats.sensors import fixes_csv, gyroscope_csv
from mqslam.formats.sensors.boreas_fixes import TIME, read_boreas_fixes
from mqslam.formats.sensors.boreas_imus import APPLANIX_COLUMN, DMU_NAMES, read_boreas_imu
from mqslam.formats.sensors.mulran_sensors import read_mulran_fixes, read_mulran_imu
from mqslam.formats.sensors.nmea import read_nmea
from mqslam.formats.sensors.oxford_ins import STATUS, read_ins_fixes, read_ins_rates
from mqslam.formats.sensors.reading import Reading
from mqslam.formats.sensors.sensor_table import read_header

__all__ = ["read_fixes", "read_gyroscope"]


@untrusted.reads_file
def read_gyroscope(path: Path) -> Reading[Gyroscope]:
    """Reads a file of a gyroscope: CSV `t,wx,wy,wz`, or one of those that Oxford, Boreas and MulRan have.

    Raises:
        DataError: the file cannot be read, is none of these, or holds fewer than two sound rows.
    """
    header = read_header(path, gyroscope_csv.REMEDY)
    if path.name in DMU_NAMES or APPLANIX_COLUMN in header.names:
        return read_boreas_imu(path)
    if STATUS in header.names:
        return read_ins_rates(header)
    return read_mulran_imu(header) if header.holds_numbers else gyroscope_csv.read_gyroscope_csv(header)


@untrusted.reads_file
def read_fixes(path: Path, start_us: int) -> Reading[Fixes]:
    """Reads a file of GNSS fixes: NMEA, CSV `t,lat,lon[,sigma_m]`, or one of those that Oxford, Boreas and MulRan have.

    Args:
        path: the file.
        start_us: stamp of the recording's start [us], from which an NMEA log without a date takes it.

    Raises:
        DataError: the file cannot be read, is none of these, or holds no fix.
    """
    if _holds_sentences(path):
        return read_nmea(path, start_us)
    header = read_header(path, fixes_csv.REMEDY)
    if "latitude" in header.names:
        return read_boreas_fixes(header) if TIME in header.names else read_ins_fixes(header)
    return read_mulran_fixes(header) if header.holds_numbers else fixes_csv.read_fixes_csv(header)


def _holds_sentences(path: Path) -> bool:
    """Returns whether a file is an NMEA log: by its suffix, or since a sentence stands in its first line."""
    try:
        with untrusted.open_text(path, "ascii", "replace") as lines:
            return path.suffix.lower() == ".nmea" or "$" in lines.readline(200)
    except FileNotFoundError as error:
        raise DataError(path, "does not exist", "check the path") from error
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror})", fixes_csv.REMEDY) from error
