"""Gyroscopes as CSV with the header `t,wx,wy,wz`: `imu.csv` beside a recording in Oxford's form, or a user's own file."""

from __future__ import annotations

from pathlib import Path

from mqslam.core.sensors import Gyroscope
from mqslam.execution.files import write_text
from mqslam.formats.sensors.reading import Reading, make_gyroscope
from mqslam.formats.sensors.sensor_table import Header, read_converted
from mqslam.formats.shared.columns import RATES

REMEDY = "give a CSV whose header is t,wx,wy,wz: microseconds, and rad/s about x forward, y left and z up"


def read_gyroscope_csv(header: Header) -> Reading[Gyroscope]:
    """Reads a gyroscope from a CSV: t in us, wx, wy and wz in rad/s about x forward, y left, z up.

    Args:
        header: the first line of the file.

    Raises:
        DataError: a column is missing, or fewer than two rows can be used.
    """
    table = read_converted(header, [(name, RATES) for name in ("wx", "wy", "wz")], REMEDY)
    return make_gyroscope(header.path, str(header.path), table)


def write_gyroscope_csv(path: Path, gyroscope: Gyroscope) -> None:
    """Writes a gyroscope as `t,wx,wy,wz` [us, rad/s]."""
    lines = ["t,wx,wy,wz"]
    for stamp, (x, y, z) in zip(gyroscope.stamps_us.tolist(), gyroscope.rates.tolist(), strict=True):
        lines.append(f"{stamp},{x:.12g},{y:.12g},{z:.12g}")
    write_text(path, "\n".join(lines) + "\n")
