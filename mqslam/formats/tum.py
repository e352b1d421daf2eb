"""Reads and writes trajectories in TUM's format: a stamp, a position and a quaternion per line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.errors import DataError, untrusted
from mqslam.execution.files import write_text
from mqslam.formats.poses import make_trajectory, read_yaw, round_yaw
from mqslam.formats.stamps import guess_unit, parse_stamps
from mqslam.formats.text import read_lines

WIDE = (8 + 36, 8 + 21, 8 + 12)
"""Counts of numbers in a line with a pose and a covariance: the whole matrix, its upper triangle, or the upper triangles of
its blocks of rotation and position."""
WIDTHS = "8 numbers per line, or {}, {} or {} with a covariance after the pose".format(*sorted(WIDE))
"""Counts of numbers in the lines of all forms of TUM, in words for messages."""
_REMEDY = f"give a TUM trajectory ({WIDTHS})"


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Writes `t[s] x y z qx qy qz qw` per line, as evo reads it.

    A file that is read and written again stays the same text: the yaw is rounded to fewer digits than the quaternion has.
    """
    rows = zip(trajectory.stamps_us.tolist(), *trajectory.poses.T.tolist(), strict=True)
    write_text(path, "".join(f"{format_tum(row)}\n" for row in rows))


def format_tum(row: tuple[int, float, float, float]) -> str:
    """Returns the line of TUM for a row of stamp [us], x, y [m] and yaw [rad], without a line break."""
    stamp, x, y, yaw = row
    half = round_yaw(yaw) / 2
    seconds = f"{stamp // 1_000_000}.{stamp % 1_000_000:06d}"
    return f"{seconds} {x:.6f} {y:.6f} 0 0 0 {np.sin(half):.12f} {np.cos(half):.12f}"


@untrusted.reads_file
def read_tum(path: Path) -> Trajectory:
    """Reads a TUM file: `t[s] x y z qx qy qz qw`, `#` starts a comment; z, roll and pitch are dropped.

    A covariance after the pose (36, 21 or 12 more numbers) is skipped: `mqslam.formats.covariances` reads it. If the largest
    stamp is above 1e11, all stamps are taken as milliseconds, above 1e14 as microseconds, above 1e17 as nanoseconds.

    Raises:
        DataError: the file cannot be read, has a line of other than 8, 44, 29 or 20 finite numbers or with a quaternion of
            zeros, fewer than two poses, or stamps that do not increase.
    """
    times: list[str] = []
    poses: list[tuple[float, float, float]] = []
    for number, line in enumerate(read_lines(path, _REMEDY), 1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        try:
            values = [float(word) for word in words]
            if len(values) not in (8, *WIDE) or not np.isfinite(values).all():
                raise ValueError
        except ValueError:
            problem = f"is not 't x y z qx qy qz qw' in finite numbers, as it has {count_of(len(words), 'word')}"
            if len(words) in (8, *WIDE):
                problem = "is not made of finite numbers"
            raise DataError(path, f"line {number} {problem}", _REMEDY) from None
        times.append(words[0])
        poses.append((values[1], values[2], read_yaw(path, f"line {number}", values[4:8])))
    try:
        unit = guess_unit(max((abs(float(time)) for time in times), default=0.0))
        stamps = parse_stamps(times, unit) if unit != "s" else np.array([_parse_stamp(t) for t in times], dtype=np.int64)
    except ValueError as error:
        raise DataError(path, str(error), f"{_REMEDY}, with stamps in seconds") from error
    return make_trajectory(path, stamps, np.array(poses, dtype=np.float64).reshape(-1, 3))


def _parse_stamp(seconds: str) -> int:
    """Parses decimal seconds as a stamp [us] by their digits, since a float would round them."""
    whole, _, fraction = seconds.partition(".")
    if whole.isdigit() and (fraction.isdigit() or not fraction):
        return int(whole) * 1_000_000 + int((fraction + "000000")[:6])
    return round(float(seconds) * 1e6)
