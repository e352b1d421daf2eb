"""Trajectories that other software wrote: TUM, KITTI, CSV with a header, or a topic of a ROS bag. KITTI is also written."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.execution.files import write_text
from mqslam.formats.shared import bags
from mqslam.formats.shared.poses import make_trajectory, yaw_of_quaternion
from mqslam.formats.shared.stamps import parse_stamps, time_unit
from mqslam.formats.tum import read_tum

_KNOWN = "give TUM, KITTI with a file of times, a CSV whose header names t, x, y and yaw or qx, qy, qz, qw, or a bag"
_YAWS = ("yaw", "theta", "heading")
_QUATERNION = ("qx", "qy", "qz", "qw")
_POSE_TYPES = (bags.ODOMETRY_TYPE, bags.POSE_TYPE, bags.POSE_WITH_COVARIANCE_TYPE, bags.PATH_TYPE)


def read_trajectory(path: Path, times: Path | None = None, topic: str | None = None) -> Trajectory:
    """Reads a trajectory; its format shows in its content, the unit of its stamps in their name or size.

    - TUM: `t[s] x y z qx qy qz qw` per line.
    - KITTI: the 12 numbers of a 3x4 pose matrix per line, stamps in `times`. Where y varies least and the motion runs along
      the poses' own z, they are poses of a camera (x right, y down, z forward): its z and -x become x and y. Everything
      else lies in the x-y plane.
    - CSV: a header with t (or time, timestamp, stamp; a unit may follow: t_us, time [ns]), x, y, and yaw, theta or heading
      [rad], counter-clockwise from x, or qx, qy, qz, qw.
    - a ROS bag: the only topic of odometry, poses or paths, or the named one; of paths the last message.

    Args:
        path: file, or folder of a ROS 2 bag.
        times: a stamp per line, for KITTI alone.
        topic: a topic, for bags alone.

    Raises:
        DataError: the file is none of these, holds a value that is not a number, or its stamps do not increase.
    """
    if bags.recognises(path):
        _refuse_times(path, times)
        return _read_bag(path, topic)
    rows = _read_rows(path)
    first = next((row for row in rows if not row.startswith("#")), "")
    columns = len(first.split())
    if "," not in first and columns == 12:
        return _read_kitti(path, rows, times)
    _refuse_times(path, times)
    if "," in first:
        return _read_csv(path, rows)
    if columns == 8:
        return read_tum(path)
    raise DataError(path, f"is no trajectory in a known format ({columns} words in its first line)", _KNOWN)


def _refuse_times(path: Path, times: Path | None) -> None:
    """Refuses a file of times beside a trajectory that carries its own.

    Raises:
        DataError: there is one.
    """
    if times is not None:
        raise DataError(times, f"is not needed: {path.name} is no KITTI file and carries its own stamps", "leave it out")


def _read_rows(path: Path) -> list[str]:
    """Reads the lines of a text file that are not blank."""
    try:
        return [line.strip() for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
    except FileNotFoundError as error:
        raise DataError(path, "does not exist", "check the path") from error
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8"
        raise DataError(path, f"is not a readable text file ({reason})", _KNOWN) from error


def _parse_numbers(path: Path, rows: list[list[str]], columns: list[int]) -> NDArray[np.float64]:
    """Parses columns (N, len(columns)) of rows of words."""
    table = np.empty((len(rows), len(columns)))
    for row, words in enumerate(rows):
        try:
            table[row] = [float(words[column]) for column in columns]
        except (ValueError, IndexError):
            table[row] = np.nan
    if not np.isfinite(table).all():
        row = int(np.argmin(np.isfinite(table).all(axis=1)))
        raise DataError(path, f"pose {row + 1} is not made of finite numbers", "repair or remove its line")
    return table


def _parse_stamps(path: Path, words: list[str], unit: str = "") -> NDArray[np.int64]:
    """Parses words as stamps [us]."""
    try:
        return parse_stamps(words, unit)
    except ValueError as error:
        raise DataError(path, str(error), "give stamps in s, us or ns") from error


def _read_kitti(path: Path, rows: list[str], times: Path | None) -> Trajectory:
    """Reads matrices of poses, with their stamps from a file of their own."""
    if times is None:
        raise DataError(path, "is a KITTI trajectory, which holds no stamps", "give the file of its times, one per line")
    words = [row.split() for row in rows if not row.startswith("#")]
    if wrong := next((number for number, row in enumerate(words, 1) if len(row) != 12), 0):
        raise DataError(path, f"pose {wrong} is not 12 numbers", "repair or remove its line")
    stamps = _parse_stamps(times, [row.split()[0] for row in _read_rows(times) if not row.startswith("#")])
    if len(stamps) != len(words):
        raise DataError(times, f"holds {len(stamps)} stamps for the {len(words)} poses of {path.name}", "give one per pose")
    matrices = _parse_numbers(path, words, list(range(12))).reshape(-1, 3, 4)
    return make_trajectory(path, stamps, _project_camera(matrices) if _is_camera(matrices) else _project_ground(matrices))


def _is_camera(matrices: NDArray[np.float64]) -> bool:
    """Returns whether poses (N, 3, 4) are a camera's: y, its height, varies less than z, and it moves along its own z."""
    turns, places = matrices[:, :, :3], matrices[:, :, 3]
    moved = np.einsum("nij,ni->nj", turns[:-1], np.diff(places, axis=0))
    ahead_x, _, ahead_z = np.abs(moved).sum(axis=0)
    return bool(np.ptp(places[:, 1]) < np.ptp(places[:, 2]) and ahead_z > ahead_x)


def _project_camera(matrices: NDArray[np.float64]) -> se2.Array:
    """Projects camera poses (N, 3, 4) (x right, y down, z forward) as poses (N, 3): forward becomes x, left y."""
    yaw = np.arctan2(-matrices[:, 0, 2], matrices[:, 2, 2])
    return np.column_stack([matrices[:, 2, 3], -matrices[:, 0, 3], yaw])


def _project_ground(matrices: NDArray[np.float64]) -> se2.Array:
    """Projects poses (N, 3, 4) into the x-y plane as poses (N, 3)."""
    return np.column_stack([matrices[:, 0, 3], matrices[:, 1, 3], np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0])])


def _read_csv(path: Path, rows: list[str]) -> Trajectory:
    """Reads the columns of times and poses of a CSV with a header."""
    header = 0 if "," in rows[0] else next(row for row, text in enumerate(rows) if not text.startswith("#"))
    named = [name.strip(" \"'") for name in rows[header].lstrip("# ").split(",")]
    names = [re.split(r"[\s\[(]", name.lower())[0] for name in named]
    units = [time_unit(name) for name in named]
    stamp = next((column for column, unit in enumerate(units) if unit is not None), None)
    turn = next(([name] for name in _YAWS if name in names), list(_QUATERNION))
    missing = ["t"] if stamp is None else []
    missing += [name for name in ("x", "y", *turn) if name not in names]
    if stamp is None or missing:
        raise DataError(path, f"has no column {', '.join(missing)} (columns: {', '.join(named[:20])})", _KNOWN)
    words = [row.split(",") for row in rows[header + 1 :] if not row.startswith("#")]
    table = _parse_numbers(path, words, [stamp, *(names.index(name) for name in ("x", "y", *turn))])
    stamps = _parse_stamps(path, [row[stamp].strip() for row in words], units[stamp] or "")
    yaws = [row[3] if len(row) == 4 else yaw_of_quaternion(*row[3:]) for row in table.tolist()]
    return make_trajectory(path, stamps, np.column_stack([table[:, 1:3], np.array(yaws, dtype=np.float64)]))


def _read_bag(path: Path, topic: str | None) -> Trajectory:
    """Reads the poses on a topic, or on the only topic that holds any."""
    with bags.open_bag(path) as reader:
        there = sorted({c.topic for c in reader.connections if c.msgtype in _POSE_TYPES and c.msgcount})
        chosen = [name for name in there if topic in (None, name)]
        if len(chosen) != 1:
            problem = f"has no poses on {topic}" if topic else f"has {len(there)} topics of poses"
            listed = f"topics of poses: {', '.join(there[:12])}" if there else f"topics: {bags.list_topics(reader)}"
            raise DataError(path, f"{problem} ({listed})", "name the topic of the trajectory")
        poses: list[bags.PoseRow] = []
        for connection, _, raw in reader.messages([c for c in reader.connections if c.topic == chosen[0]]):
            message: Any = reader.deserialize(raw, connection.msgtype)
            if connection.msgtype == bags.PATH_TYPE:
                poses = [bags.pose_of(bags.POSE_TYPE, pose) for pose in message.poses]
            else:
                poses.append(bags.pose_of(connection.msgtype, message))
    trajectory = bags.trajectory_of(poses)
    if trajectory is None:
        raise DataError(path, f"holds no two poses at different times on {chosen[0]}", "name another topic")
    return trajectory


def write_kitti(path: Path, trajectory: Trajectory) -> None:
    """Writes the first three rows of every pose's 4x4 matrix, 12 numbers a line, as evo reads it: x-y plane, no stamps."""
    lines = []
    for x, y, yaw in trajectory.poses.tolist():
        c, s = np.cos(yaw), np.sin(yaw)
        lines.append(f"{c:.9f} {-s:.9f} 0 {x:.6f} {s:.9f} {c:.9f} 0 {y:.6f} 0 0 1 0\n")
    write_text(path, "".join(lines))
