"""CARMEN logs: `.log`, `.log.gz` and `.clf`, the scans of a planar lidar with a pose beside each.

FLASER names no angles: its n readings sweep 180 degrees from -90 on. An even n ends a step before +90 (180: -90 to +89 by 1,
360: -90 to +89.5 by 0.5), an odd n at +90 (181 by 1, 361 by 0.5). On the Intel and ACES logs this gives sharper maps than
centring an even number or stretching it over the half turn. Other numbers of readings are of other lidars: what these sweep
is stated by a setting or by the log's parameters, or the log is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.config import USUAL_READING, ReadingConfig
from mqslam.core import se2
from mqslam.core.scans import Returns
from mqslam.core.sensors.lidar import LidarRecording, stamp_scans
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.errors import DataError
from mqslam.formats.lidars.carmen_lines import CarmenLog, OdometryLine, ScanLine, read_log
from mqslam.formats.shared.stamps import mark_increasing, parse_stamps

# A lidar log is clipped at its longest range if more than this share of its readings have that range.
_LIDAR_CLIP_SHARE = 1e-3
# Least number of readings at the longest range of a lidar log that is clipped there.
_LIDAR_CLIP_COUNT = 10
# No lidar log is clipped at a range below this [m].
_LIDAR_CLIP_M = 3.0
# Poses in a lidar log that differ by less than this [m] count as equal: it is written to centimetres.
_LIDAR_SAME_M = 0.01
# Headings in a lidar log that differ by less than this [rad] count as equal.
_LIDAR_SAME_RAD = 0.01
# Poses beside the scans of a lidar log that stay within this [m] of its odometry are the odometry's own, and no SLAM has
# corrected them.
_LIDAR_SAME_TRACK_M = 0.05
# Headings beside the scans of a lidar log that stay within this [rad] of its odometry are the odometry's own.
_LIDAR_SAME_TRACK_RAD = 0.02

_ENDINGS = (".log", ".log.gz", ".clf", ".clf.gz")
_ERROR_CODES_M = 81.82  # SICK lidars write what they could not measure as 81.83 m to 81.91 m
_CLIP_TOLERANCE_M = 1e-6  # ranges are written with fewer digits
_LEAST_MAXIMUM_M = 1.0  # a smaller maximum among the parameters is no lidar's
_HALF_TURNS = {180, 181, 360, 361}  # readings of SICK's lidars, whose field of view is 180 degrees
_FIELDS_OF_VIEW = ("laser_front_laser_fov", "laser_laser1_fov")  # parameters [degrees]
_LEAST_FOV_DEG, _FULL_DEG = 10.0, 360.0  # what a lidar sweeps; a smaller number may be in radians
_FEW = 90  # readings of no lidar that is known: more than two degrees apart over half a turn
_MOST_METRES, _MOST_OFFSET_M = 100.0, 2.0  # larger maxima and offsets among the parameters are in centimetres


def recognises(path: Path) -> bool:
    """Returns whether the path is a file called `.log`, `.log.gz`, `.clf` or `.clf.gz`."""
    return path.name.lower().endswith(_ENDINGS) and path.is_file()


def read_lidar(path: Path, settings: ReadingConfig = USUAL_READING) -> LidarRecording:
    """Reads a CARMEN log.

    All beams of a scan have the scan's time, the only one in the format. The trajectory is the sensor's pose beside each
    scan. The odometry is that of the ODOM lines, or in a log without them the robot's pose beside each scan where it is
    not just the sensor's; both are carried from the robot to the sensor.

    Args:
        path: the log.
        settings: how recordings are understood.

    Raises:
        DataError: the log cannot be read, a line is cut short, or there are fewer than two scans with returns.
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
    odometry = robot_odometry and Trajectory(robot_odometry.stamps_us, se2.compose(robot_odometry.poses, mount))
    notes += [*clipped, *chaining]
    if np.any(mount != 0.0):
        notes.append(f"the lidar's pose on the robot is {mount[0]:.3g} m, {mount[1]:.3g} m, {mount[2]:.3g} rad")
    if odometry is not None and _is_same_motion(trajectory, odometry):
        notes.append("the poses beside the scans are the odometry's: no SLAM corrected them")
    return LidarRecording(path, "carmen", stamp_scans(stamps, returns), trajectory, odometry, tuple(notes))


def _choose_scans(
    path: Path, log: CarmenLog, kind: str, settings: ReadingConfig
) -> tuple[NDArray[np.int64], list[ScanLine], list[str]]:
    """Chooses the scans of a kind whose stamps increase; returns stamps (N,) [us], scans, and what was left out."""
    notes = []
    if others := {name: log.messages[name] for name in log.messages if "LASER" in name and name != kind}:
        notes.append(f"scans other than {kind} are left out: " + ", ".join(f"{n} {name}" for name, n in others.items()))
    stamps = _parse_stamps(path, [scan.stamp for scan in log.scans[kind]])
    rows = np.flatnonzero(mark_increasing(stamps.tolist())).tolist()
    if len(rows) < 2:
        there = ", ".join(f"{count} {name}" for name, count in log.messages.most_common(8)) or "none"
        problem = f"holds {len(rows)} scans with stamps that increase (messages: {there[:200]})"
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
    """Returns FLASER scans with the angles that the user or the log's parameters state, and a note.

    Raises:
        DataError: nobody states what their readings sweep, and their number does not tell it.
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
    if counts <= _HALF_TURNS and fov_deg in (180.0, 181.0):  # what the lidars of such logs sweep in any case
        return scans, []
    spread = []
    for scan in scans:
        half = np.radians(fov_deg) / 2.0
        spread.append(replace(scan, angles=np.linspace(-half, half, len(scan.ranges), endpoint=fov_deg < _FULL_DEG)))
    return spread, [f"the readings of a scan sweep {fov_deg:g} degrees, as {whose} states it"]


def _parse_stamps(path: Path, words: list[str]) -> NDArray[np.int64]:
    """Parses words [s] as stamps [us]."""
    try:
        return parse_stamps(words, "s")
    except ValueError as error:
        raise DataError(path, str(error), "remove the lines, or copy the log anew") from error


def _drop_clipped(
    scans: Sequence[ScanLine], times: NDArray[np.float64], parameters: dict[str, float]
) -> tuple[list[Returns], list[str]]:
    """Drops the readings of scans, at times (N,) [s], that are no returns; returns the others and a note."""
    below = np.concatenate([scan.ranges[scan.ranges < min(scan.maximum_m, _ERROR_CODES_M)] for scan in scans])
    ceiling = _find_ceiling(below, sum(len(scan.ranges) for scan in scans), parameters)
    returns = []
    for scan, time in zip(scans, times.tolist(), strict=True):
        seen = (scan.ranges > 0.0) & (scan.ranges < min(scan.maximum_m, _ERROR_CODES_M, ceiling))
        count = int(np.count_nonzero(seen))
        returns.append(Returns(scan.ranges[seen], scan.angles[seen], np.full(count, time), scan.remissions[seen]))
    return returns, [f"ranges of {ceiling:.4g} m and above are no returns"] if np.isfinite(ceiling) else []


def _find_ceiling(ranges: NDArray[np.float64], readings: int, parameters: dict[str, float]) -> float:
    """Finds the range [m] that a log clips at below the sensor's own maximum, or inf.

    It is the longest range where that is repeated too often to be a place, else the maximum the parameters name, in
    metres or centimetres, unless some range is longer: robot_front_laser_max may bound the robot's avoidance instead.
    """
    longest = float(ranges.max(initial=0.0))
    clipped = int(np.count_nonzero(ranges >= longest - _CLIP_TOLERANCE_M))
    often = clipped > max(_LIDAR_CLIP_COUNT, _LIDAR_CLIP_SHARE * readings)
    if longest >= _LIDAR_CLIP_M and often:
        return longest - _CLIP_TOLERANCE_M
    named = parameters.get("robot_front_laser_max", 0.0)
    named = named if named <= _MOST_METRES else named / 100.0
    return named if _LEAST_MAXIMUM_M <= named < _ERROR_CODES_M and longest <= named else np.inf


def _find_mount(sensor: se2.Array, robot: se2.Array, parameters: dict[str, float]) -> tuple[se2.Array, bool]:
    """Finds the pose (3,) of the lidar on the robot, and whether the poses (N, 3) of both are rigidly connected.

    Where they are, apart from each other, they show it; else robot_frontlaser_offset says it, in metres or, above 2,
    centimetres.
    """
    offset = parameters.get("robot_frontlaser_offset", 0.0)
    named = np.array([offset if abs(offset) <= _MOST_OFFSET_M else offset / 100.0, 0.0, 0.0])
    apart = se2.wrapped_between(robot, sensor)
    shown = np.median(apart, axis=0)
    off = np.abs(apart - shown)
    same_m, same_rad = _LIDAR_SAME_M, _LIDAR_SAME_RAD
    rigid = bool(off[:, :2].max() < same_m and off[:, 2].max() < same_rad)
    separate = bool(np.any(np.abs(shown) > [same_m, same_m, same_rad]))
    return (shown if rigid and separate else named), rigid


def _chain_odometry(path: Path, lines: list[OdometryLine], scans: list[ScanLine]) -> tuple[Trajectory | None, list[str]]:
    """Returns the robot's odometry, or None where it has not two poses, and notes on what was done to it.

    A log that a SLAM run wrote starts its odometry anew from the corrected pose after every scan. What the wheels measured
    are the steps in between: they are chained, and the jumps to the anchors are left out.
    """
    poses = np.array([line.pose for line in lines])
    anchored = np.array([line.anchored for line in lines])
    notes = []
    if anchored.any():
        steps = se2.wrapped_between(poses[:-1], poses[1:])
        steps[anchored[1:]] = 0.0
        poses = se2.compose(poses[0], se2.integrate_steps(steps))
        notes.append(f"the odometry starts anew from {anchored.sum()} corrected poses: its steps are chained instead")
    measured = np.flatnonzero(~anchored)
    stamps = np.zeros(len(lines), dtype=np.int64)
    stamps[measured] = _parse_stamps(path, [lines[row].stamp for row in measured])
    fitting = measured[_mark_consistent(stamps, lines, scans)[measured]]
    rows = fitting[mark_increasing(stamps[fitting].tolist())]
    if dropped := len(measured) - len(rows):
        notes.append(f"{dropped} of {len(measured)} odometry poses whose stamps repeat or run backward are left out")
    return (Trajectory(stamps[rows], poses[rows]) if len(rows) > 1 else None), notes


def _mark_consistent(stamps: NDArray[np.int64], lines: list[OdometryLine], scans: list[ScanLine]) -> NDArray[np.bool_]:
    """Marks the odometry lines (M,), stamped (M,) [us], that do not contradict those written with the scans.

    The line right above a scan, with the scan's stamp, is the odometry of that scan. Where stamps run to and fro (by up
    to a second in the Intel log), these lines stay, and lines between them in the log must lie between them in time.
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
    """Returns whether two trajectories differ only in the frame they start in, by centimetres at the stamps of the first."""
    one, other = a.poses, b.at(a.stamps_us)
    apart = se2.wrapped_between(se2.between(one[0], one), se2.between(other[0], other))
    limits = [_LIDAR_SAME_TRACK_M, _LIDAR_SAME_TRACK_M, _LIDAR_SAME_TRACK_RAD]
    return bool(np.all(np.abs(apart) < limits))
