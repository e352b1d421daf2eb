"""Reads CARMEN logs (`.log`, `.log.gz` and `.clf`): the scans of a planar lidar, each with poses of lidar and robot.

A scan is a FLASER or ROBOTLASER1 line, a pose of the odometry is an ODOM line. A FLASER line states no angles. Its readings
begin at -90 degrees. An odd number of readings ends at +90 degrees (181 readings by 1 degree, 361 by 0.5). An even number
ends one step before +90 degrees (180 readings: -90 to +89 by 1, 360: -90 to +89.5 by 0.5): on the Intel and ACES logs this
gives sharper maps than centring the readings or stretching them over 180 degrees. Other numbers of readings come from other
lidars. For these, a setting or the log's parameters must state the field of view; else the log is refused, unless a scan has
fewer than 90 readings.
"""

from __future__ import annotations

import codecs
import gzip
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.config import USUAL_READING, ReadingConfig
from mqslam.core import se2
from mqslam.core.recording import LidarRecording, stamp_scans
from mqslam.core.scans import Returns
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.errors import DataError, untrusted
from mqslam.formats.stamps import mark_increasing
from mqslam.formats.tables import parse_times

# A log counts as clipped at its longest range if this range is at least so long [m], and if more than this share and this
# number of readings have this range.
_CLIP_M, _CLIP_SHARE, _CLIP_COUNT = 3.0, 1e-3, 10
_SAME = np.array([0.01, 0.01, 0.01])  # poses [m, m, rad] that differ by less count as equal: logs are rounded to centimetres
# Poses [m, m, rad] of scans that differ from the odometry by less than this are the odometry itself, not a SLAM result.
_SAME_TRACK = np.array([0.05, 0.05, 0.02])
_ENDINGS = (".log", ".log.gz", ".clf", ".clf.gz")
_ERROR_CODES_M = 81.82  # SICK lidars state 81.83 m to 81.91 m where they could not measure a range
_CLIP_TOLERANCE_M = 1e-6  # ranges are written with fewer decimals than this
_LEAST_MAXIMUM_M = 1.0  # no lidar has a smaller maximum range
_HALF_TURNS = {180, 181, 360, 361}  # numbers of readings in a scan of SICK's lidars, which see 180 degrees
_FIELDS_OF_VIEW = ("laser_front_laser_fov", "laser_laser1_fov")  # parameters [degrees]
_LEAST_FOV_DEG, _FULL_DEG = 10.0, 360.0  # bounds of a field of view; smaller numbers may be in radians
_FEW = 90  # no known lidar has fewer readings: over 180 degrees, readings would lie more than two degrees apart
_MOST_METRES, _MOST_OFFSET_M = 100.0, 2.0  # larger maxima and offsets among the parameters are in centimetres
_LONGEST_LINE = 1 << 20  # [bytes] longer lines would fill the memory
_GZIP_MAGIC = b"\x1f\x8b"
_REPAIR = "remove the lines, or copy the log again"
_MOST_EXPANSION = 100  # a file may unpack to this many times its size: numbers pack to a tenth of their size


def recognises(path: Path) -> bool:
    """Returns whether the path is a file called `.log`, `.log.gz`, `.clf` or `.clf.gz`."""
    return path.name.lower().endswith(_ENDINGS) and path.is_file()


def read_lidar(path: Path, settings: ReadingConfig = USUAL_READING) -> LidarRecording:
    """Reads a CARMEN log.

    If a log has FLASER and ROBOTLASER1 lines, only the kind with more lines is read. All beams of a scan have the scan's
    time, since the format states no times of beams. The trajectory consists of the lidar's poses in the scan lines. The
    odometry comes from the ODOM lines. In a log without ODOM lines it comes from the robot's poses in the scan lines, unless
    these differ from the lidar's poses only by a constant offset: then they hold no second measurement, and there is no
    odometry. Poses of the robot are converted to poses of the lidar.

    Args:
        path: the log.
        settings: values that the log may not state, such as the field of view.

    Raises:
        DataError: the log cannot be read, a line is cut short, the field of view is not stated, there are fewer than two
            scans, or no scan has a return.
    """
    log = read_log(path)
    kind = max(log.scans, key=lambda name: len(log.scans[name]))
    stamps, scans, notes = _choose_scans(path, log, kind, settings)
    returns, clipped = _drop_clipped(scans, (stamps - stamps[0]) * 1e-6, log.parameters)
    if not any(len(scan) for scan in returns):
        raise DataError(path, "holds no range below the lidar's maximum", "give a log in which the lidar saw something")
    trajectory = Trajectory(stamps, np.array([scan.sensor for scan in scans]))
    robot = Trajectory(stamps, np.array([scan.robot for scan in scans]))
    mount, rigid = _find_mount(trajectory.poses, robot.poses, log.parameters)
    if log.odometry:
        robot_odometry, chaining = _chain_odometry(path, log.odometry, scans)
    else:
        robot_odometry, chaining = None if rigid else robot, []
    odometry = robot_odometry and robot_odometry.attach(mount)
    notes += [*clipped, *chaining]
    if np.any(mount != 0.0):
        notes.append(f"the lidar's pose on the robot is {mount[0]:z.3g} m, {mount[1]:z.3g} m, {mount[2]:z.3g} rad")
    if odometry is not None and _is_same_motion(trajectory, odometry):
        notes.append("the poses in the scan lines are the odometry: no SLAM system has corrected them")
    return LidarRecording.of(path, "carmen", stamp_scans(stamps, returns), trajectory, odometry, tuple(notes))


def _choose_scans(
    path: Path, log: CarmenLog, kind: str, settings: ReadingConfig
) -> tuple[NDArray[np.int64], list[ScanLine], list[str]]:
    """Chooses the scans of one kind whose stamps increase; returns their stamps (N,) [us], the scans, and notes on this."""
    notes = []
    if others := {name: log.messages[name] for name in log.messages if "LASER" in name and name != kind}:
        notes.append(f"scans other than {kind} are left out: " + ", ".join(f"{n} {name}" for name, n in others.items()))
    stamps = parse_times(path, [scan.stamp for scan in log.scans[kind]], "s", _REPAIR)
    rows = np.flatnonzero(mark_increasing(stamps.tolist())).tolist()
    if len(rows) < 2:
        there = ", ".join(f"{count} {name}" for name, count in log.messages.most_common(8)) or "none"
        held = count_of(len(rows), "scan")
        problem = f"holds {held} with increasing stamps, but two are needed (messages: {there[:200]})"
        raise DataError(path, problem, "give a CARMEN log with FLASER or ROBOTLASER1 lines")
    if dropped := len(log.scans[kind]) - len(rows):
        notes.append(f"{count_of(dropped, 'scan')} with a stamp that repeats or runs backward: left out")
    scans = [log.scans[kind][row] for row in rows]
    if kind == "FLASER":
        scans, spread = _spread_readings(path, scans, log.parameters, settings)
        notes += spread
    return stamps[rows], scans, notes


def _spread_readings(
    path: Path, scans: list[ScanLine], parameters: dict[str, float], settings: ReadingConfig
) -> tuple[list[ScanLine], list[str]]:
    """Spreads the readings of FLASER scans over the field of view that the user or the log's parameters state.

    Returns the scans, and notes for the user on their field of view. If no field of view is stated, the scans keep their
    angles, which span 180 degrees.

    Raises:
        DataError: no field of view is stated, and a scan has 90 readings or more, but not as many as a lidar that is known
            to see 180 degrees.
    """
    fov_deg, whose = settings.lidar_fov_deg, "reading.lidar_fov_deg"
    for name in _FIELDS_OF_VIEW if fov_deg is None else ():
        if _LEAST_FOV_DEG <= parameters.get(name, 0.0) <= _FULL_DEG:
            fov_deg, whose = parameters[name], name
            break
    counts = {len(scan.ranges) for scan in scans}
    if fov_deg is None:
        if odd := sorted(count for count in counts - _HALF_TURNS if count >= _FEW):
            problem = f"holds scans of {odd[0]} readings, and does not say what angle they sweep"
            raise DataError(path, problem, "state it by reading.lidar_fov_deg, such as 240 for a Hokuyo URG-04LX")
        odd = sorted(counts - _HALF_TURNS)
        return scans, [f"scans of {odd[0]} readings are taken to span 180 degrees"] if odd else []
    if counts <= _HALF_TURNS and fov_deg in (180.0, 181.0):  # these scans have such angles already
        return scans, []
    spread = []
    for scan in scans:
        half = np.radians(fov_deg) / 2.0
        spread.append(replace(scan, angles=np.linspace(-half, half, len(scan.ranges), endpoint=fov_deg < _FULL_DEG)))
    return spread, [f"the readings of a scan sweep {fov_deg:g} degrees, as {whose} states it"]


def _drop_clipped(
    scans: Sequence[ScanLine], times: NDArray[np.float64], parameters: dict[str, float]
) -> tuple[list[Returns], list[str]]:
    """Converts scan lines to returns; also returns a list with a note for the user if the log clips long ranges.

    Ranges of 0, clipped ranges, and ranges from the lidar's maximum on are left out.

    Args:
        scans: the N scans.
        times: (N,) time of each scan [s].
        parameters: parameters of the log.
    """
    below = np.concatenate([scan.ranges[scan.ranges < min(scan.maximum_m, _ERROR_CODES_M)] for scan in scans])
    ceiling = _find_ceiling(below, sum(len(scan.ranges) for scan in scans), parameters)
    returns = []
    for scan, time in zip(scans, times.tolist(), strict=True):
        seen = (scan.ranges > 0.0) & (scan.ranges < min(scan.maximum_m, _ERROR_CODES_M, ceiling))
        count = int(np.count_nonzero(seen))
        returns.append(Returns(scan.ranges[seen], scan.angles[seen], np.full(count, time), scan.remissions[seen]))
    return returns, [f"ranges of {ceiling:.4g} m and above are clipped and left out"] if np.isfinite(ceiling) else []


def _find_ceiling(ranges: NDArray[np.float64], readings: int, parameters: dict[str, float]) -> float:
    """Finds the range [m] at which a log clips its readings, below the lidar's own maximum; inf if the log clips none.

    The longest range is this limit if it is 3 m or more and occurs too often to be a real object. Else the limit is the
    parameter robot_front_laser_max, in metres or centimetres. The parameter is ignored if some range is longer, since it may
    limit the robot's obstacle avoidance instead.

    Args:
        ranges: (K,) all ranges below the lidar's maximum [m].
        readings: number of all readings in the scans of the log.
        parameters: parameters of the log.
    """
    longest = float(ranges.max(initial=0.0))
    clipped = int(np.count_nonzero(ranges >= longest - _CLIP_TOLERANCE_M))
    if longest >= _CLIP_M and clipped > max(_CLIP_COUNT, _CLIP_SHARE * readings):
        return longest - _CLIP_TOLERANCE_M
    named = parameters.get("robot_front_laser_max", 0.0)
    named = named if named <= _MOST_METRES else named / 100.0
    return named if _LEAST_MAXIMUM_M <= named < _ERROR_CODES_M and longest <= named else np.inf


def _find_mount(sensor: se2.Array, robot: se2.Array, parameters: dict[str, float]) -> tuple[se2.Array, bool]:
    """Finds the pose (3,) of the lidar on the robot, and whether the poses (N, 3) of both are rigidly connected.

    Poses are x, y [m], yaw [rad]. If the poses of lidar and robot are rigidly connected and differ, their difference is the
    lidar's pose on the robot. Else the lidar lies ahead of the robot's origin by the parameter robot_frontlaser_offset, in
    metres or, if it is above 2, in centimetres; without this parameter, it lies at the origin.
    """
    offset = parameters.get("robot_frontlaser_offset", 0.0)
    named = np.array([offset if abs(offset) <= _MOST_OFFSET_M else offset / 100.0, 0.0, 0.0])
    apart = se2.wrapped_between(robot, sensor)
    shown = np.median(apart, axis=0)
    rigid = bool((np.abs(apart - shown) < _SAME).all())
    return (shown if rigid and np.any(np.abs(shown) > _SAME) else named), rigid


def _chain_odometry(path: Path, lines: list[OdometryLine], scans: list[ScanLine]) -> tuple[Trajectory | None, list[str]]:
    """Returns (1) the robot's odometry, None for fewer than two poses; (2) notes for the user on resets and omitted poses.

    In a log that a SLAM run wrote, the odometry starts again from the corrected pose after every scan. The wheels measured
    only the steps between these jumps: the steps are chained, and the jumps are left out.
    """
    poses = np.array([line.pose for line in lines])
    anchored = np.array([line.anchored for line in lines])
    notes = []
    if anchored.any():
        steps = se2.wrapped_between(poses[:-1], poses[1:])
        steps[anchored[1:]] = 0.0
        poses = se2.compose(poses[0], se2.integrate_steps(steps))
        notes.append(f"the odometry is reset to a corrected pose {anchored.sum()} times: only steps between resets are used")
    measured = np.flatnonzero(~anchored)
    stamps = np.zeros(len(lines), dtype=np.int64)
    stamps[measured] = parse_times(path, [lines[row].stamp for row in measured], "s", _REPAIR)
    fitting = measured[_mark_consistent(stamps, lines, scans)[measured]]
    rows = fitting[mark_increasing(stamps[fitting].tolist())]
    if dropped := len(measured) - len(rows):
        notes.append(f"{dropped} of {len(measured)} odometry poses whose stamps repeat or run backward are left out")
    return (Trajectory(stamps[rows], poses[rows]) if len(rows) > 1 else None), notes


def _mark_consistent(stamps: NDArray[np.int64], lines: list[OdometryLine], scans: list[ScanLine]) -> NDArray[np.bool_]:
    """Returns a mask (M,) of the ODOM lines whose stamps (M,) [us] fit the order of the lines in the log.

    If the last ODOM line above a scan has the scan's stamp and is not anchored, it belongs to the scan and is always marked.
    Stamps of other ODOM lines may run back and forth (by up to a second in the Intel log). Such a line is marked if its
    stamp lies between the stamps of the nearest lines above and below that belong to scans.
    """
    above = ((scan.odometry_above - 1, scan.stamp) for scan in scans if scan.odometry_above)
    pinned = {row for row, stamp in above if lines[row].stamp == stamp and not lines[row].anchored}
    pins = np.array(sorted(pinned), dtype=np.int64)
    edges = np.concatenate([[np.iinfo(np.int64).min], stamps[pins], [np.iinfo(np.int64).max]])
    interval = np.searchsorted(pins, np.arange(len(stamps)), side="right")
    fits: NDArray[np.bool_] = (edges[interval] < stamps) & (stamps < edges[interval + 1])
    fits[pins] = True
    return fits


def _is_same_motion(a: Trajectory, b: Trajectory) -> bool:
    """Returns whether trajectories, moved to one first pose, differ by less than 5 cm and 0.02 rad at the stamps of `a`."""
    one, other = a.poses, b.at(a.stamps_us)
    apart = se2.wrapped_between(se2.between(one[0], one), se2.between(other[0], other))
    return bool(np.all(np.abs(apart) < _SAME_TRACK))


@dataclass(frozen=True, slots=True)
class ScanLine:
    """A FLASER or ROBOTLASER1 line.

    Args:
        stamp: stamp [s], as the text in the log.
        ranges: (n,) measured ranges [m].
        angles: (n,) directions of the readings [rad], counter-clockwise from straight ahead.
        remissions: (n,) strength of the echoes, in the lidar's own units; 0 if the line states none.
        maximum_m: the lidar's maximum range [m] that the line states; inf if it states none.
        sensor: (3,) pose of the lidar x, y [m], yaw [rad] in the log's frame.
        robot: (3,) pose of the robot x, y [m], yaw [rad] in the log's frame.
        odometry_above: number of ODOM lines above this line in the log.
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
        stamp: stamp [s], as the text in the log.
        pose: (3,) pose of the robot x, y [m], yaw [rad].
        anchored: whether the line measures nothing, but resets the odometry to the corrected pose in the scan line before.
            Such a line repeats this pose, and its stamp is earlier than the stamp of the last line that is not anchored.
    """

    stamp: str
    pose: NDArray[np.float64]
    anchored: bool


@dataclass(frozen=True, slots=True)
class CarmenLog:
    """The content of a log.

    Args:
        scans: the scan lines by their kind, in the order of the log.
        odometry: the ODOM lines in the order of the log.
        parameters: the numbers that PARAM lines state, by the name of the parameter.
        messages: number of lines of each kind, including kinds that are not read.
    """

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
            if kind in log.scans:
                before = (_parse_flaser if kind == "FLASER" else _parse_robotlaser)(words, len(log.odometry))
                log.scans[kind].append(before)
            elif kind == "ODOM":
                pose, stamp = _parse_finite(words[1:4], 3), float(words[7])
                repeats = isinstance(before, ScanLine) and np.array_equal(pose, before.sensor)
                before = OdometryLine(words[7], pose, repeats and not stamp >= latest)
                log.odometry.append(before)
                latest = latest if before.anchored else stamp
            elif kind == "PARAM" and len(words) > 2:
                with suppress(ValueError):  # other parameters are words
                    log.parameters[words[1]] = float(_parse_finite(words[2:3], 1)[0])
        except (ValueError, IndexError):
            remedy = "remove the line, or copy the log again"
            raise DataError(path, f"line {number} is not a complete {kind} message of numbers", remedy) from None
    return log


def _read_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yields the number, from 1, and the text of each line of a log.

    Raises:
        DataError: the log cannot be read, a line is longer than a mebibyte, or the log unpacks to far more than its size.
    """
    limit = _LONGEST_LINE + _MOST_EXPANSION * path.stat().st_size if path.exists() else 0
    try:
        with (
            untrusted.check_file(path).open("rb") as plain,
            gzip.open(plain) if plain.peek(2)[:2] == _GZIP_MAGIC else plain as lines,
        ):
            number = unpacked = 0
            while line := lines.readline(_LONGEST_LINE):
                number += 1
                line = line.removeprefix(codecs.BOM_UTF8) if number == 1 else line
                unpacked += len(line)
                if unpacked > limit:
                    raise DataError(path, f"unpacks to more than {limit / 1e6:.0f} MB", "give a CARMEN log")
                if len(line) == _LONGEST_LINE:
                    raise DataError(path, f"line {number} is longer than a line of numbers can be", "give a CARMEN log")
                yield number, line.decode("ascii", errors="replace")
    except (OSError, EOFError, zlib.error) as error:
        raise DataError(
            path, f"is not a readable log ({str(error) or type(error).__name__})", "copy the file again"
        ) from error


def _parse_flaser(words: list[str], above: int) -> ScanLine:
    """Parses the words of a FLASER line; `above` is the number of ODOM lines above it."""
    count = int(words[1])
    ranges, tail = _parse_numbers(words[2:], count), words[2 + count :]
    step = np.pi / max(count - count % 2, 1)
    angles = -np.pi / 2 + step * np.arange(count, dtype=np.float64)
    poses = _parse_finite(tail[:6], 6)
    return ScanLine(_check_stamp(tail[6]), ranges, angles, np.zeros(count), np.inf, poses[:3], poses[3:], above)


def _parse_robotlaser(words: list[str], above: int) -> ScanLine:
    """Parses the words of a ROBOTLASER1 line; `above` is the number of ODOM lines above it."""
    start, view, resolution, maximum = (float(words[column]) for column in (2, 3, 4, 5))
    count = int(words[8])
    if resolution <= 0.0:  # some programs leave the resolution out
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
    """Returns the text of a stamp unchanged; raises ValueError if it is no number."""
    float(word)
    return word


def _parse_numbers(words: list[str], count: int) -> NDArray[np.float64]:
    """Parses the first `count` words as numbers; raises ValueError if there are fewer words, or if one is no number."""
    if not 0 <= count <= len(words):
        raise ValueError(count)
    return np.array(words[:count], dtype=np.float64)


def _parse_finite(words: list[str] | list[float], count: int) -> NDArray[np.float64]:
    """Parses words as finite numbers; raises ValueError if there are not `count` words, or if a word is no finite number."""
    values = np.array(words, dtype=np.float64)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise ValueError(words)
    return values
