"""GNSS fixes as CSV with the header `t,lat,lon[,sigma_m]`: `gnss.csv` beside a recording in Oxford's form, or a user's."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mqslam.core.sensors import Fixes
from mqslam.execution.files import write_text
from mqslam.formats.sensors.reading import Reading, make_fixes
from mqslam.formats.sensors.sensor_table import Header, read_converted
from mqslam.formats.shared.columns import DEGREES

REMEDY = "give an NMEA log, or a CSV whose header is t,lat,lon[,sigma_m]: microseconds, degrees and metres"


def read_fixes_csv(header: Header, *, made_truth: bool = False) -> Reading[Fixes]:
    """Reads fixes from a CSV: t in us, lat and lon in degrees and, where the receiver states it, sigma_m in m.

    Args:
        header: the first line of the file.
        made_truth: whether the recording's ground truth was made from them.

    Raises:
        DataError: a column is missing, or no row can be used.
    """
    stated = [("sigma_m", {"m": 1.0})] if "sigma_m" in header.names else []
    table = read_converted(header, [("lat", DEGREES), ("lon", DEGREES), *stated], REMEDY)
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
