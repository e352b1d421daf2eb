"""The lines of a CARMEN log, parsed and not yet understood.

PARAM name value ...
ODOM x y theta tv rv accel ipc_timestamp host logger_timestamp
FLASER n r_1 .. r_n x y theta odom_x odom_y odom_theta ipc_timestamp host logger_timestamp
ROBOTLASER1 type start_angle field_of_view resolution maximum_range accuracy remission_mode n r_1 .. r_n m rem_1 .. rem_m
    laser_x laser_y laser_theta robot_x robot_y robot_theta tv rv forward side axis ipc_timestamp host logger_timestamp
"""

from __future__ import annotations

import codecs
import gzip
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError, untrusted

_LONGEST_LINE = 1 << 20  # [bytes] longer lines would fill the memory
_GZIP_MAGIC = b"\x1f\x8b"
_MOST_EXPANSION = 100  # a file may unpack to this many times its size: numbers pack to a tenth


@dataclass(frozen=True, slots=True)
class ScanLine:
    """A FLASER or ROBOTLASER1 line.

    Args:
        stamp: as written [s].
        ranges: (n,) [m].
        angles: (n,) [rad] counter-clockwise from straight ahead.
        remissions: (n,) 0 where the line has none.
        maximum_m: the range the line names as the sensor's maximum [m], or inf.
        sensor: (3,) pose of the lidar.
        robot: (3,) pose of the robot.
        odometry_above: number of ODOM lines above this one.
    """

    stamp: str
    ranges: NDArray[np.float64]
    angles: NDArray[np.float64]
    remissions: NDArray[np.float64]
    maximum_m: float
    sensor: NDArray[np.float64]
    robot: NDArray[np.float64]
    odometry_above: int


@dataclass(frozen=True, slots=True)
class OdometryLine:
    """An ODOM line.

    Args:
        stamp: as written [s].
        pose: (3,) pose of the robot.
        anchored: whether it moves the odometry to the pose of the scan line before it and measures nothing: it repeats
            that pose, and its stamp lies before those of the lines above.
    """

    stamp: str
    pose: NDArray[np.float64]
    anchored: bool


@dataclass(frozen=True, slots=True)
class CarmenLog:
    """The content of a log in its order; `messages` counts all kinds of lines, also those that are not kept."""

    scans: dict[str, list[ScanLine]] = field(default_factory=lambda: {"FLASER": [], "ROBOTLASER1": []})
    odometry: list[OdometryLine] = field(default_factory=list)
    parameters: dict[str, float] = field(default_factory=dict)
    messages: Counter[str] = field(default_factory=Counter)


def read_log(path: Path) -> CarmenLog:
    """Reads a log, compressed by gzip or not.

    Raises:
        DataError: the log cannot be read, or a line is cut short or holds something other than numbers.
    """
    log = CarmenLog()
    before: ScanLine | OdometryLine | None = None
    latest = -np.inf
    for number, line in _read_lines(path):
        words = line.split()
        kind = words[0] if words else "#"
        if kind.startswith("#"):
            continue
        log.messages[kind] += 1
        try:
            if kind == "FLASER":
                before = _parse_flaser(words, len(log.odometry))
                log.scans[kind].append(before)
            elif kind == "ROBOTLASER1":
                before = _parse_robotlaser(words, len(log.odometry))
                log.scans[kind].append(before)
            elif kind == "ODOM":
                pose, stamp = _parse_finite(words[1:4], 3), float(words[7])
                repeats = isinstance(before, ScanLine) and np.array_equal(pose, before.sensor)
                before = OdometryLine(words[7], pose, repeats and not stamp >= latest)
                log.odometry.append(before)
                latest = latest if before.anchored else stamp
            elif kind == "PARAM" and len(words) > 2:
                _keep_parameter(log.parameters, words[1], words[2])
        except (ValueError, IndexError):
            remedy = "remove the line, or copy the log anew"
            raise DataError(path, f"line {number} is no whole {kind} message of numbers", remedy) from None
    return log


def _read_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Reads the lines of a log with their numbers; a line is never held beyond a mebibyte."""
    limit = _LONGEST_LINE + _MOST_EXPANSION * path.stat().st_size if path.exists() else 0
    try:
        with untrusted.check_file(path).open("rb") as plain, gzip.open(plain) if _is_gzip(plain) else plain as lines:
            number = unpacked = 0
            while line := lines.readline(_LONGEST_LINE):
                number += 1
                line = line.removeprefix(codecs.BOM_UTF8) if number == 1 else line
                unpacked += len(line)
                if unpacked > limit:
                    raise DataError(path, f"unpacks to more than {limit / 1e6:.0f} MB", "give a CARMEN log")
                if len(line) == _LONGEST_LINE:
                    raise DataError(path, f"line {number} does not end", "give a CARMEN log")
                yield number, line.decode("ascii", errors="replace")
    except (OSError, EOFError, zlib.error) as error:
        raise DataError(path, f"is not a readable log ({str(error) or type(error).__name__})", "copy it anew") from error


def _is_gzip(file: IO[bytes]) -> bool:
    """Returns whether a file that is open at its beginning is compressed; it is left there."""
    magic = file.read(2)
    file.seek(0)
    return magic == _GZIP_MAGIC


def _parse_flaser(words: list[str], above: int) -> ScanLine:
    """Parses the words of a FLASER line, with the number of ODOM lines above it."""
    count = int(words[1])
    ranges, tail = _parse_numbers(words[2:], count), words[2 + count :]
    step = np.pi / max(count - count % 2, 1)
    angles = -np.pi / 2 + step * np.arange(count, dtype=np.float64)
    poses = _parse_finite(tail[:6], 6)
    return ScanLine(_check_stamp(tail[6]), ranges, angles, np.zeros(count), np.inf, poses[:3], poses[3:], above)


def _parse_robotlaser(words: list[str], above: int) -> ScanLine:
    """Parses the words of a ROBOTLASER1 line, with the number of ODOM lines above it."""
    start, view, resolution, maximum = (float(words[column]) for column in (2, 3, 4, 5))
    count = int(words[8])
    if resolution <= 0.0:  # some programs leave it out
        resolution = _parse_finite([view], 1)[0] / max(count - 1, 1)
    if resolution <= 0.0:
        raise ValueError(words[3])
    ranges, rest = _parse_numbers(words[9:], count), words[9 + count :]
    reflected = int(rest[0])
    remissions, tail = _parse_numbers(rest[1:], reflected), rest[1 + reflected :]
    poses = _parse_finite(tail[:6], 6)
    angles = _parse_finite([start, resolution], 2)[0] + resolution * np.arange(count)
    remissions = remissions if reflected == count else np.zeros(count)
    limit = maximum if maximum > 0.0 else np.inf
    return ScanLine(_check_stamp(tail[11]), ranges, angles, remissions, limit, poses[:3], poses[3:], above)


def _check_stamp(word: str) -> str:
    """Returns a word, and checks that it is a number."""
    float(word)
    return word


def _parse_numbers(words: list[str], count: int) -> NDArray[np.float64]:
    """Parses the first `count` words as numbers.

    Raises:
        ValueError: there are fewer words, or one is no number.
    """
    if not 0 <= count <= len(words):
        raise ValueError(count)
    return np.array(words[:count], dtype=np.float64)


def _parse_finite(words: list[str] | list[float], count: int) -> NDArray[np.float64]:
    """Parses all words as `count` finite numbers."""
    values = np.array(words, dtype=np.float64)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise ValueError(words)
    return values


def _keep_parameter(parameters: dict[str, float], name: str, value: str) -> None:
    """Keeps a parameter whose value is a finite number; others are words."""
    try:
        number = float(value)
    except ValueError:
        return
    if np.isfinite(number):
        parameters[name] = number
