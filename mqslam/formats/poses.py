"""Checks the planar poses that files state, and makes trajectories of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.errors import DataError

_FARTHEST = 1e9  # no coordinate of any frame on the Earth is larger [m]


def yaw_of_quaternion(qx: float, qy: float, qz: float, qw: float) -> float:
    """Returns the yaw [rad] of a quaternion of any norm, or NaN for a quaternion of zeros, which is no rotation."""
    if not any((qx, qy, qz, qw)):
        return float("nan")
    return float(np.arctan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz))


def read_yaw(path: Path, place: str, quaternion: Sequence[float]) -> float:
    """Returns the yaw [rad] of a quaternion x, y, z, w of any norm; `place`, such as `line 3`, names it in the error.

    Raises:
        DataError: the quaternion is zero.
    """
    yaw = yaw_of_quaternion(*quaternion)
    if np.isnan(yaw):
        raise DataError(path, f"{place} has a quaternion of zeros", "give a rotation; 0 0 0 1 has a yaw of 0")
    return yaw


def round_yaw(yaw: float) -> float:
    """Rounds a yaw [rad] to nine decimals in (-pi, pi): its sine and cosine with 12 digits then give the same yaw again."""
    return float(np.clip(round(float(se2.wrap(yaw)), 9), -3.141592653, 3.141592653))


def mark_places(numbers: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
    """Returns a mask (...,) of the positions or poses (..., D) [m, rad] whose D numbers are all finite and at most 1e9."""
    return np.asarray((np.abs(numbers) <= _FARTHEST).all(axis=-1))  # NaN compares as false


def make_trajectory(path: Path, stamps_us: NDArray[np.int64], poses: se2.Array) -> Trajectory:
    """Makes a trajectory of a file's stamps (N,) [us] and poses (N, 3), x [m], y [m], yaw [rad].

    Raises:
        DataError: there are fewer than two poses, a pose is not finite or over 1e9 m away, or the stamps do not increase.
    """
    if len(stamps_us) < 2:
        raise DataError(path, f"holds {count_of(len(stamps_us), 'pose')}", "a trajectory needs at least two poses")
    if np.any(np.diff(stamps_us) <= 0):
        row = int(np.argmax(np.diff(stamps_us) <= 0)) + 2
        raise DataError(path, f"stamps do not increase at pose {row}", "sort the file by time and drop duplicates")
    if not (sound := mark_places(poses)).all():
        problem = f"pose {int(np.argmin(sound)) + 1} is not made of finite numbers up to 1e9"
        raise DataError(path, problem, "repair or remove its line")
    return Trajectory(stamps_us, poses)
