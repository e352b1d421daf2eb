"""Poses as matrices: KITTI's 12 numbers per line, the same with a stamp, or a NumPy array of them. KITTI is also written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError, untrusted
from mqslam.execution.files import write_text
from mqslam.formats.shared.poses import make_trajectory, round_yaw
from mqslam.formats.trajectories.pose_rows import parse_numbers, parse_times, read_rows

_NUMBERS = 12  # of the upper three rows of a 4x4 matrix
_MATRICES = "give an array of pose matrices (N, 4, 4) or (N, 3, 4)"


def read_kitti(path: Path, rows: list[str], times: Path | None) -> Trajectory:
    """Reads matrices of poses, with their stamps from a file of their own.

    Args:
        path: the file.
        rows: its lines that are not blank.
        times: file whose lines begin with a stamp each.

    Raises:
        DataError: there are no stamps or not one per pose, or a line holds something other than 12 finite numbers.
    """
    times = _require_times(path, times)
    words = _split(path, rows, _NUMBERS)
    stamps = _read_times(path, times, len(words))
    return _make_trajectory(path, stamps, parse_numbers(path, words, range(_NUMBERS)).reshape(-1, 3, 4))


def read_stamped_matrices(path: Path, rows: list[str]) -> Trajectory:
    """Reads matrices of poses of which each is followed by its stamp, as TBV SLAM writes the nodes of its graph.

    Args:
        path: the file.
        rows: its lines that are not blank.

    Raises:
        DataError: a line holds something other than 12 finite numbers and a stamp, or the stamp comes first.
    """
    words = _split(path, rows, _NUMBERS + 1)
    table = parse_numbers(path, words, range(_NUMBERS + 1))
    if np.all(table[:, 0] > table[:, -1]):
        problem = "begins its lines with a stamp, as the odometry of Boreas does, whose poses are inverse"
        raise DataError(path, problem, "give the trajectory as TUM, or as KITTI with the file of its times")
    stamps = parse_times(path, [row[-1] for row in words])
    return _make_trajectory(path, stamps, table[:, :_NUMBERS].reshape(-1, 3, 4))


def read_array(path: Path, times: Path | None) -> Trajectory:
    """Reads an `.npy` of pose matrices (N, 4, 4) or (N, 3, 4), with their stamps from a file of their own.

    Raises:
        DataError: there are no stamps or not one per pose, or the file holds anything else than such finite matrices.
    """
    times = _require_times(path, times)
    try:
        matrices = np.load(untrusted.check_file(path), mmap_mode="r", allow_pickle=False)  # maps no more than the file has
    except FileNotFoundError as error:
        raise DataError(path, "does not exist", "check the path") from error
    except Exception as error:  # the header is parsed as a Python literal
        raise DataError(path, "is not a readable .npy of numbers", _MATRICES) from error
    if matrices.ndim != 3 or matrices.shape[1:] not in ((4, 4), (3, 4)) or matrices.dtype.kind not in "fiu":
        raise DataError(path, f"holds {matrices.dtype} of shape {matrices.shape}", _MATRICES)
    return _make_trajectory(path, _read_times(path, times, len(matrices)), np.array(matrices[:, :3], dtype=np.float64))


def write_kitti(path: Path, trajectory: Trajectory) -> None:
    """Writes the first three rows of every pose's 4x4 matrix, 12 numbers a line, as evo reads it: x-y plane, no stamps."""
    lines = []
    for x, y, yaw in trajectory.poses.tolist():
        c, s = np.cos(round_yaw(yaw)), np.sin(round_yaw(yaw))
        lines.append(f"{c:.12f} {-s:.12f} 0 {x:.6f} {s:.12f} {c:.12f} 0 {y:.6f} 0 0 1 0\n")
    write_text(path, "".join(lines))


def _require_times(path: Path, times: Path | None) -> Path:
    """Returns the file of the stamps of poses that have none.

    Raises:
        DataError: there is none.
    """
    if times is None:
        what = "an array of poses" if path.suffix == ".npy" else "a KITTI trajectory"
        raise DataError(path, f"is {what}, which holds no stamps", "give the file of its times, one per line")
    return times


def _split(path: Path, rows: list[str], count: int) -> list[list[str]]:
    """Splits the rows that are no comments into words, of which each row has a given count."""
    words = [row.split() for row in rows if not row.startswith("#")]
    if wrong := next((number for number, row in enumerate(words, 1) if len(row) != count), 0):
        raise DataError(path, f"pose {wrong} is not {count} numbers", "repair or remove its line")
    return words


def _read_times(path: Path, times: Path, count: int) -> NDArray[np.int64]:
    """Reads the first words of the lines of a file as the stamps [us] of a count of poses in another file."""
    stamps = parse_times(times, [row.split()[0] for row in read_rows(times) if not row.startswith("#")])
    if len(stamps) != count:
        raise DataError(times, f"holds {len(stamps)} stamps for the {count} poses of {path.name}", "give one per pose")
    return stamps


def _make_trajectory(path: Path, stamps: NDArray[np.int64], matrices: NDArray[np.float64]) -> Trajectory:
    """Makes a trajectory of stamps (N,) [us] and poses (N, 3, 4) of a camera or of anything else."""
    if not np.isfinite(matrices).all():
        row = int(np.argmin(np.isfinite(matrices).all(axis=(1, 2)))) + 1
        raise DataError(path, f"pose {row} is not made of finite numbers", "leave it out")
    return make_trajectory(path, stamps, _project_camera(matrices) if _is_camera(matrices) else _project_ground(matrices))


def _is_camera(matrices: NDArray[np.float64]) -> bool:
    """Returns whether poses (N, 3, 4) are a camera's: y, its height, varies less than z, and it moves along its own z."""
    if not len(matrices):
        return False
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
