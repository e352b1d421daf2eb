"""Tables of poses: CSV with a header that names its columns."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.shared.poses import make_trajectory, read_yaw
from mqslam.formats.shared.stamps import time_unit
from mqslam.formats.trajectories.pose_rows import KNOWN, parse_numbers, parse_times

_YAWS = ("yaw", "theta", "heading")
_QUATERNION = ("qx", "qy", "qz", "qw")


def read_table(path: Path, rows: list[str]) -> Trajectory:
    """Reads the columns of times and poses of a CSV with a header.

    Args:
        path: the file.
        rows: its lines that are not blank.

    Raises:
        DataError: a column is missing or holds a value that is not a number, a rotation is a quaternion of zeros, or its
            stamps do not increase.
    """
    header = 0 if "," in rows[0] else next(row for row, text in enumerate(rows) if not text.startswith("#"))
    named = [name.strip(" \"'") for name in rows[header].lstrip("# ").split(",")]
    names = [re.split(r"[\s\[(]", name.lower())[0] for name in named]
    units = [time_unit(name) for name in named]
    stamp = next((column for column, unit in enumerate(units) if unit is not None), None)
    turn = next(([name] for name in _YAWS if name in names), list(_QUATERNION))
    missing = ["t"] if stamp is None else []
    missing += [name for name in ("x", "y", *turn) if name not in names]
    if stamp is None or missing:
        raise DataError(path, f"has no column {', '.join(missing)} (columns: {', '.join(named[:20])})", KNOWN)
    words = [row.split(",") for row in rows[header + 1 :] if not row.startswith("#")]
    table = parse_numbers(path, words, [stamp, *(names.index(name) for name in ("x", "y", *turn))])
    stamps = parse_times(path, [row[stamp].strip() for row in words], units[stamp] or "")
    rows_of_numbers = enumerate(table.tolist(), 1)
    yaws = [row[3] if len(row) == 4 else read_yaw(path, f"pose {k}", row[3:]) for k, row in rows_of_numbers]
    return make_trajectory(path, stamps, np.column_stack([table[:, 1:3], np.array(yaws, dtype=np.float64)]))
