"""Tables of poses: CSV with a header that names its columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.shared.columns import METRES, RADIANS, find_column, find_stamps, join_stamps
from mqslam.formats.shared.poses import make_trajectory, read_yaw
from mqslam.formats.trajectories.pose_rows import KNOWN, parse_numbers

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
    names, stamps_at = [name.lower() for name in named], find_stamps(named)
    yaw = next((name for name in _YAWS if find_column(path, names, name, RADIANS) is not None), None)
    wanted = [("x", METRES), ("y", METRES), *([(yaw, RADIANS)] if yaw else [(name, {}) for name in _QUATERNION])]
    found = [find_column(path, names, name, units) for name, units in wanted]
    missing = [] if stamps_at else ["t"]
    missing += [name for (name, _), column in zip(wanted, found, strict=True) if column is None]
    if missing:
        raise DataError(path, f"has no column {', '.join(missing)} (columns: {', '.join(named[:20])})", KNOWN)
    columns, factors = zip(*(column for column in found if column is not None), strict=True)
    words = [row.split(",") for row in rows[header + 1 :] if not row.startswith("#")]
    times = [column for column, _ in stamps_at]
    table = parse_numbers(path, words, [*times, *columns])[:, len(times) - 1 :] * np.array([1.0, *factors])
    try:
        stamps = join_stamps([[row[column].strip() for row in words] for column in times], [unit for _, unit in stamps_at])
    except ValueError as error:
        raise DataError(path, str(error), "give stamps in s, us or ns") from error
    rows_of_numbers = enumerate(table.tolist(), 1)
    yaws = [row[3] if len(row) == 4 else read_yaw(path, f"pose {k}", row[3:]) for k, row in rows_of_numbers]
    return make_trajectory(path, stamps, np.column_stack([table[:, 1:3], np.array(yaws, dtype=np.float64)]))
