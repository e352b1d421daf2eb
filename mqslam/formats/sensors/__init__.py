"""Reads gyroscopes, GNSS receivers and mounts from separate files, from the files of a recording, and from bags."""

from __future__ import annotations

from pathlib import Path

from mqslam.core.sensors import Fixes
from mqslam.errors import untrusted
from mqslam.formats.sensors.csv_files import FIXES_REMEDY, read_fixes_table
from mqslam.formats.sensors.csv_files import read_gyroscope_table as read_gyroscope
from mqslam.formats.sensors.nmea import read_nmea
from mqslam.formats.sensors.reading import Reading
from mqslam.formats.text import open_lines

__all__ = ["read_fixes", "read_gyroscope"]


@untrusted.reads_file
def read_fixes(path: Path, start_us: int) -> Reading[Fixes]:
    """Reads a file of GNSS fixes: NMEA, CSV `t,lat,lon[,sigma_m]`, or a table of Oxford, Boreas or MulRan.

    Args:
        path: the file.
        start_us: stamp of the recording's start [us], from which an NMEA log without dates takes its date.

    Raises:
        DataError: the file cannot be read, has none of these forms, or holds no fix.
    """
    with open_lines(path, FIXES_REMEDY, "replace") as lines:
        is_log = path.suffix.lower() == ".nmea" or "$" in lines.readline(200)
    return read_nmea(path, start_us) if is_log else read_fixes_table(path)
