"""The GNSS fixes of Boreas and Boreas-RT: `applanix/gps_post_process.csv`, or `applanix/gps.csv`.

Source: github.com/utiasASRL/pyboreas, DATA_REFERENCE.md. Positions are those of the Applanix frame.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mqslam.core.sensors import Fixes
from mqslam.formats.sensors.reading import Reading, make_fixes
from mqslam.formats.sensors.sensor_table import Header, read_header, read_sensor_table

TIME = "gpstime"
_PLACE = ("latitude", "longitude")
_REMEDY = "give a file of a Boreas recording whose header names GPSTime, latitude and longitude"


def find_boreas_fixes(root: Path) -> Header | None:
    """Returns the header of the file of the fixes, or None where no file names latitude and longitude.

    Raises:
        DataError: a file is there, but is no text.
    """
    for name in ("gps_post_process.csv", "gps.csv"):
        file = root / "applanix" / name
        if file.exists() and {TIME, *_PLACE} <= set((header := read_header(file, _REMEDY)).names):
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
    table = read_sensor_table(header, header.find((TIME, *_PLACE), _REMEDY))
    largest = np.nanmedian(np.abs(table.columns), axis=0) if np.isfinite(table.columns).any(axis=0).all() else np.zeros(2)
    in_radians = bool(largest[0] <= np.pi / 2 and largest[1] <= np.pi)
    degrees = np.rad2deg(table.columns) if in_radians else table.columns
    columns = np.column_stack([degrees, np.full(len(degrees), np.nan)])
    note = f"latitudes and longitudes in {header.path} are taken as {'radians' if in_radians else 'degrees'}"
    return make_fixes(header.path, str(header.path), table.with_columns(columns), note, made_truth=True)
