"""Odometry files: poses as TUM or CSV, or body twists as CSV, chained into poses; and tables of numbers beside images."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError, untrusted
from mqslam.execution.files import write_text
from mqslam.formats.shared.columns import METRES, RATES, SPEEDS, find_column, find_stamps, join_stamps
from mqslam.formats.shared.poses import make_trajectory
from mqslam.formats.shared.stamps import parse_stamps
from mqslam.formats.trajectories.pose_table import read_table
from mqslam.formats.tum import read_tum

_LEAST_SLIDE = 1e-9  # sideways speeds below this [m/s] are rounding errors
_TWIST = (("v", SPEEDS), ("omega", RATES), ("vy", SPEEDS))
_Read = TypeVar("_Read")


@untrusted.reads_file
def read_odometry(path: Path) -> Trajectory:
    """Reads an odometry file: TUM, CSV with the header `t,v,omega` and optionally `vy`, or a CSV of poses.

    In the CSV t is in us, v and vy in m/s, omega in rad/s (REP 103). The twist of a row holds until the next row's
    stamp, so the poses lie on exact constant-twist arcs; the first pose is the origin.

    Raises:
        DataError: the file cannot be read, is in neither layout or holds a non-number, or its stamps do not increase.
    """
    try:
        with untrusted.open_text(path, "utf-8-sig") as lines:
            first = next((line for line in lines if line.strip() and not line.lstrip().startswith("#")), "")
    except FileNotFoundError as error:
        raise DataError(path, "does not exist", "check the path of the odometry, or take the recording's own") from error
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(path, "is not a readable text file", "give TUM or a CSV with columns t,v,omega") from error
    return _read_twists(path, first) if "," in first else read_tum(path)


def read_beside(read: Callable[[], _Read]) -> tuple[_Read | None, list[str]]:
    """Reads a file beside the images of a recording; where it cannot be used, the images still can.

    Args:
        read: reads it, or raises a DataError.

    Returns:
        What was read, or None and the fault where it cannot be used.
    """
    try:
        return read(), []
    except DataError as error:
        return None, [f"{error.path} {error.problem}: left out"]


@untrusted.reads_file
def read_numbers(path: Path, columns: list[int]) -> NDArray[np.float64]:
    """Reads columns (N, len(columns)) of a CSV whose first line is a header.

    Raises:
        DataError: a row is too short or holds something other than finite numbers.
    """
    return _read_table(path, _read_rows(path)[1:], columns)


@untrusted.reads_file
def read_stamped(path: Path, columns: list[int]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Reads stamps (N,) [us] and columns (N, len(columns)) of a CSV with or without a header.

    The first column holds whole stamps in us or ns, too long for a float. Rows are returned in the order of their stamps,
    and only one of those that share a stamp.

    Raises:
        DataError: a row is too short or holds something other than finite numbers.
    """
    rows = _read_rows(path)
    rows = rows[1:] if rows and not rows[0].lstrip()[:1].isdigit() else rows
    try:
        stamps, order = np.unique(parse_stamps([row.split(",", 1)[0].strip() for row in rows]), return_index=True)
    except ValueError as error:
        raise _no_table(path, error) from error
    return stamps, _read_table(path, rows, columns)[order]


def _read_rows(path: Path) -> list[str]:
    """Reads the lines of a text file that are neither empty nor a comment."""
    try:
        text = untrusted.read_text(path, "utf-8-sig").split("\n")
    except (OSError, ValueError) as error:
        raise _no_table(path, error) from error
    return [line for line in text if line.strip() and not line.startswith("#")]


def _read_table(path: Path, rows: list[str], columns: list[int]) -> NDArray[np.float64]:
    """Reads columns of rows (N,) of text."""
    try:
        table = np.loadtxt(rows, delimiter=",", usecols=columns, ndmin=2) if rows else np.empty((0, len(columns)))
        if not np.isfinite(table).all():
            raise ValueError(f"row {int(np.argmin(np.isfinite(table).all(axis=1))) + 2} is not finite")
    except ValueError as error:
        raise _no_table(path, error) from error
    return table


def _no_table(path: Path, error: Exception) -> DataError:
    """Words the error of a file that is no table of numbers."""
    return DataError(path, f"is not a table of numbers ({str(error).splitlines()[0]})", "repair or remove it")


def write_twists(path: Path, stamps_us: Iterable[int], twists: se2.Array) -> None:
    """Writes odometry as `t,v,omega` [us, m/s, rad/s], with `vy` where it slides; a row's twist holds until the next.

    Args:
        path: the file.
        stamps_us: (N,) [us].
        twists: (N, 3) [m/s, m/s, rad/s], of the body.
    """
    sliding = bool(np.any(np.abs(twists[:, 1]) > _LEAST_SLIDE))
    lines = ["t,v,omega,vy" if sliding else "t,v,omega"]
    for stamp, (v, vy, omega) in zip(stamps_us, twists.tolist(), strict=True):
        lines.append(f"{stamp},{v:.12g},{omega:.12g}" + (f",{vy:.12g}" if sliding else ""))
    write_text(path, "\n".join(lines) + "\n")


def _read_twists(path: Path, header: str) -> Trajectory:
    """Reads a CSV of body twists and chains them."""
    names = [name.strip(" \"'\ufeff\r\n").lower() for name in header.split(",")]
    stamps_at = find_stamps(names)
    found = {name: find_column(path, names, name, units) for name, units in _TWIST}
    missing = [] if stamps_at else ["t"]
    missing += [name for name in ("v", "omega") if found[name] is None]
    if found["v"] is None and all(find_column(path, names, name, METRES) for name in ("x", "y")):
        return read_table(path, _read_rows(path))
    if missing:
        problem = f"has no column {', '.join(missing)} (columns: {', '.join(names[:20])})"
        raise DataError(
            path, problem, "give speeds as CSV with the header t,v,omega or t,v,omega,vy, or poses as TUM or t,x,y,yaw"
        )
    columns, factors = zip(*(column for column in found.values() if column is not None), strict=True)
    rows = _read_rows(path)[1:]
    table = _read_table(path, rows, [*(column for column, _ in stamps_at), *columns])
    try:
        words = [[row.split(",")[column].strip() for row in rows] for column, _ in stamps_at]
        stamps = join_stamps(words, [unit or "us" for _, unit in stamps_at])
    except ValueError as error:
        raise DataError(path, str(error), "give them in microseconds") from error
    table = table[:, len(stamps_at) - 1 :] * np.array([1.0, *factors])
    lateral = table[:, 3] if found["vy"] is not None else np.zeros(len(table))
    twists = np.column_stack([table[:, 1], lateral, table[:, 2]])
    steps = se2.exp(twists[:-1], np.diff(stamps) * 1e-6) if len(stamps) > 1 else np.empty((0, 3))
    return make_trajectory(path, stamps, se2.integrate_steps(steps)[: len(stamps)])
