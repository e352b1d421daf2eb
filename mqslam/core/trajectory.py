"""A trajectory: stamped planar poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.errors import DataError
from mqslam.execution.files import write_text

_LATEST_US = 2**62  # beyond any clock


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Poses of the sensor over time.

    Args:
        stamps_us: (N,) int64 [us], strictly increasing, in the recording's own clock.
        poses: (N, 3) x [m], y [m], yaw [rad] in one fixed frame, REP 103.
    """

    stamps_us: NDArray[np.int64]
    poses: se2.Array

    def __len__(self) -> int:
        return len(self.stamps_us)

    @property
    def length_m(self) -> float:
        """Length of the path [m]."""
        return float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())

    def seconds(self, start_us: int) -> NDArray[np.float64]:
        """(N,) stamps [s] since another one [us]."""
        return np.asarray((self.stamps_us - start_us) * 1e-6)

    def at(self, stamps_us: NDArray[np.int64]) -> se2.Array:
        """Poses (M, 3) at other stamps (M,) [us], along constant-twist arcs; the ends are continued."""
        start = self.stamps_us[0]
        return se2.interpolate((self.stamps_us - start) * 1e-6, self.poses, (stamps_us - start) * 1e-6)

    def mean_twists(self, begins_us: NDArray[np.int64], ends_us: NDArray[np.int64]) -> se2.Array:
        """Mean twists (N, 3) [m/s, m/s, rad/s] from stamps (N,) to later ones (N,) [us]."""
        moves = se2.between(self.at(begins_us), self.at(ends_us))
        moves[:, 2] = se2.wrap(moves[:, 2])
        return np.asarray(se2.log(moves) / ((ends_us - begins_us) * 1e-6)[:, None])

    def covers(self, start_us: int, end_us: int, slack_us: int = 500_000) -> bool:
        """Whether the span from start_us to end_us lies within the trajectory, give or take slack_us at each end."""
        return bool(self.stamps_us[0] - slack_us <= start_us and end_us <= self.stamps_us[-1] + slack_us)


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write `t[s] x y z qx qy qz qw` per line, as evo and score_run.py read it."""
    lines = []
    for stamp, (x, y, yaw) in zip(trajectory.stamps_us.tolist(), trajectory.poses.tolist(), strict=True):
        seconds = f"{stamp // 1_000_000}.{stamp % 1_000_000:06d}"
        lines.append(f"{seconds} {x:.6f} {y:.6f} 0 0 0 {np.sin(yaw / 2):.9f} {np.cos(yaw / 2):.9f}\n")
    write_text(path, "".join(lines))


def write_kitti(path: Path, trajectory: Trajectory) -> None:
    """Write the first three rows of every pose's 4x4 matrix, 12 numbers a line, as evo reads it: x-y plane, no stamps."""
    lines = []
    for x, y, yaw in trajectory.poses.tolist():
        c, s = np.cos(yaw), np.sin(yaw)
        lines.append(f"{c:.9f} {-s:.9f} 0 {x:.6f} {s:.9f} {c:.9f} 0 {y:.6f} 0 0 1 0\n")
    write_text(path, "".join(lines))


def read_tum(path: Path) -> Trajectory:
    """Read a TUM file: `t[s] x y z qx qy qz qw`, `#` starts a comment; z, roll and pitch are dropped.

    Raises:
        DataError: unreadable, not eight numbers a line, or stamps that do not increase.
    """
    stamps: list[int] = []
    poses: list[tuple[float, float, float]] = []
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(path, "is not a readable text file", "give a TUM trajectory") from error
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        try:
            values = [float(word) for word in words]
            if len(values) != 8 or not np.isfinite(values).all():
                raise ValueError
            stamp = _microseconds(words[0])
            if abs(stamp) > _LATEST_US:
                raise ValueError
        except (ValueError, OverflowError):
            raise DataError(path, f"line {number} is not 't x y z qx qy qz qw'", "give a TUM trajectory") from None
        qx, qy, qz, qw = values[4:]
        stamps.append(stamp)
        poses.append((values[1], values[2], yaw_of_quaternion(qx, qy, qz, qw)))
    return checked(path, np.array(stamps, dtype=np.int64), np.array(poses, dtype=np.float64).reshape(-1, 3))


def _microseconds(seconds: str) -> int:
    """A stamp [us] of decimal seconds, which a float would round."""
    whole, _, fraction = seconds.partition(".")
    if whole.isdigit() and (fraction.isdigit() or not fraction):
        return int(whole) * 1_000_000 + int((fraction + "000000")[:6])
    return round(float(seconds) * 1e6)


def yaw_of_quaternion(qx: float, qy: float, qz: float, qw: float) -> float:
    """Yaw [rad] of a rotation given as a quaternion, of any length."""
    return float(np.arctan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz))


def checked(path: Path, stamps_us: NDArray[np.int64], poses: se2.Array) -> Trajectory:
    """A trajectory of a file's stamps and poses, once they have been found usable.

    Raises:
        DataError: fewer than two poses, one that is not finite, or stamps that do not increase.
    """
    if len(stamps_us) < 2:
        raise DataError(path, f"holds {len(stamps_us)} poses", "a trajectory needs two at least")
    if np.any(np.diff(stamps_us) <= 0):
        row = int(np.argmax(np.diff(stamps_us) <= 0)) + 2
        raise DataError(path, f"stamps do not increase at pose {row}", "sort the file by time and drop duplicates")
    finite = np.isfinite(poses).all(axis=1)
    if not finite.all():
        raise DataError(path, f"pose {int(np.argmin(finite)) + 1} is beyond all numbers", "repair or remove its line")
    return Trajectory(stamps_us, poses)
