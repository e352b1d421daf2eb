"""The first stage of a lidar's run: leaves out scans at rest, and resamples the other scans along surfaces.

Beams are spread evenly over angles, not over surfaces: hundreds of beams hit a wall beside the sensor, and a few hit a wall
far away. Two scans of one wall from different places therefore hold different points of the wall. Resampling replaces a
scan's returns by points at equal distances along the surfaces. The points then lie equally dense, from whatever place the
scan was taken. Between two neighbouring beams that hit the same surface, the surface is taken as straight.

All lengths here are proportional to a unit of length that is measured from the ranges, so that rooms and streets are treated
alike.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.recording import LidarRecording
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.core.trajectory import Trajectory

# Two neighbouring beams hit one surface if the angle between a beam and the normal of the line through their returns is at
# most this [rad].
_STEEPEST_RAD: Final = np.radians(75.0)
# If two successive returns are more than this many usual steps between beams apart, a beam between them had no return.
_WIDEST_STEP = 1.5
# Two neighbouring beams also hit one surface if their returns are at most this far apart, in units of the points' spacing.
_NEAR = 1.0
# Usual range of the objects that a radar sees in a street [m].
_USUAL_RANGE_M = 20.0
_LEAST_M: Final = 0.01  # least unit [m]; units are rounded to multiples of it
# Distance between points, and path after which a scan is kept, both in the recording's unit; rotation after which a scan is
# kept [rad].
_SPACING, _PATH, _TURN_RAD = 0.25, 0.5, np.radians(5.0)
_CHANGED = 0.4  # the sensor has moved if more than this share of the ranges differ
# If the time between two successive stamps is less than the first number times the usual time, the later scan's stamp is
# wrong, and odometry at this stamp does not show whether the sensor moved. The sensor has then moved if more than the second
# number, a share of the ranges, differ.
_HURRIED, _CHANGED_IN_HURRY = 0.5, 0.1


def spread_evenly(scan: Scan, step_rad: float, spacing_m: float) -> Scan:
    """Resamples a scan: returns a scan whose returns lie at equal distances along the surfaces that the beams hit.

    Args:
        scan: a lidar's scan, whose returns are in the order of their azimuths or of their times.
        step_rad: angle between neighbouring beams [rad].
        spacing_m: distance between the new returns [m].
    """
    seen = scan.returns
    if not len(seen):
        return scan
    table = np.column_stack([seen.ranges, seen.azimuths, seen.times, seen.intensities])
    spread = _spread(table, _WIDEST_STEP * step_rad, 1.0 / np.cos(_STEEPEST_RAD), spacing_m)
    return Scan(scan.t0, scan.t1, Returns(*np.ascontiguousarray(spread.T)))


@nb.njit(cache=True, nogil=True)
def _spread(table: NDArray[np.float64], widest: float, steepest: float, spacing: float) -> NDArray[np.float64]:
    """Returns points at equal distances along the lines between neighbouring returns on one surface.

    Args:
        table: (N, 4) range [m], azimuth [rad], time [s] and intensity of each return.
        widest: largest angle between two neighbouring returns on one surface [rad].
        steepest: largest distance between two such returns, in units of their angle times the nearer range. A distance of up
            to `spacing` is always allowed.
        spacing: distance between the points [m].

    Returns:
        (M, 4) points, with the columns of `table`. The first return on each surface is kept as it is.
    """
    n = len(table)
    kept = np.empty((n + 1, 4))
    rows = [kept[0]]
    rows.clear()
    left = 0.0  # distance along the surface to the next point
    for i in range(n):
        joined = False
        if i:
            angle = abs(table[i, 1] - table[i - 1, 1])
            x0, y0 = table[i - 1, 0] * np.cos(table[i - 1, 1]), table[i - 1, 0] * np.sin(table[i - 1, 1])
            x1, y1 = table[i, 0] * np.cos(table[i, 1]), table[i, 0] * np.sin(table[i, 1])
            length = np.hypot(x1 - x0, y1 - y0)
            nearer = min(table[i, 0], table[i - 1, 0])
            joined = angle <= widest and length <= max(_NEAR * spacing, steepest * nearer * angle)
            if joined:
                along = left
                while along < length:
                    share = along / length
                    x, y = x0 + share * (x1 - x0), y0 + share * (y1 - y0)
                    row = np.empty(4)
                    row[0], row[1] = np.hypot(x, y), table[i - 1, 1] + _turn(table[i - 1, 1], x, y)
                    row[2] = table[i - 1, 2] + share * (table[i, 2] - table[i - 1, 2])
                    row[3] = table[i - 1, 3] + share * (table[i, 3] - table[i - 1, 3])
                    rows.append(row)
                    along += spacing
                left = along - length
        if not joined:
            rows.append(table[i].copy())
            left = spacing
    result = np.empty((len(rows), 4))
    for k in range(len(rows)):
        result[k] = rows[k]
    return result


@nb.njit(cache=True, inline="always")
def _turn(azimuth: float, x: float, y: float) -> float:
    """Returns the angle [rad], in [-pi, pi), from an azimuth [rad] to the direction of a point (x, y) [m]."""
    return float((np.arctan2(y, x) - azimuth + np.pi) % (2.0 * np.pi) - np.pi)


def find_step(scans: Scans) -> float:
    """Returns the angle between neighbouring beams [rad]: the median angle between successive returns; 0 without returns."""
    steps = [np.abs(np.diff(scan.returns.azimuths)) for scan in scans if len(scan.returns) > 1]
    return float(np.median(np.concatenate(steps))) if steps else 0.0


def prepare(recording: LidarRecording, odometry: Trajectory | None, unit_m: float | None = None) -> LidarRecording:
    """Prepares a lidar's recording for a run: leaves out scans at rest and resamples the other scans along surfaces.

    The returned recording also states its unit of length, the stamps of all scans, and the odometry.

    Args:
        recording: the recording as it was read.
        odometry: poses of the sensor, which show where it is at rest; None keeps all scans.
        unit_m: unit of length of the recording [m], as `measure_unit` returns it; None measures it.
    """
    unit_m, step = measure_unit(recording.scans) if unit_m is None else unit_m, find_step(recording.scans)
    kept = recording
    if odometry is not None:
        kept = recording.take(pick_moving(recording.scans, odometry, _PATH * unit_m, _TURN_RAD))
    even = tuple(spread_evenly(scan, step, _SPACING * unit_m) for scan in kept.scans)
    scans = replace(kept.scans, scans=even, unit_m=unit_m)
    return replace(kept, scans=scans, every_us=recording.stamps_us, odometry=odometry)


def measure_unit(scans: Scans) -> float:
    """Measures a lidar's unit of length [m]: in this unit, its surroundings are about as large as a street is in metres.

    The unit is the median range divided by the usual range in a street, rounded to 0.01 m, and at least 0.01 m. In the
    median, each return is weighted by its range, since the distance between neighbouring returns grows with their range.
    """
    ranges = np.sort(np.concatenate([scan.returns.ranges for scan in scans]))
    surface = np.cumsum(ranges)
    usual = float(ranges[np.searchsorted(surface, 0.5 * surface[-1])])
    return float(np.round(usual / _USUAL_RANGE_M, 2)) or _LEAST_M


def pick_moving(scans: Scans, odometry: Trajectory, path_m: float, turn_rad: float) -> list[int]:
    """Picks the scans between which a robot has moved or turned; scans at rest add no information.

    Odometry shows whether the robot has moved. Where wheels slip or stamps are wrong, changed ranges show the motion. The
    stamps of scans that arrived late are wrong: these stamps lie close together, so that odometry seems to stand still.

    Args:
        scans: all scans.
        odometry: poses of the sensor.
        path_m: a scan is picked if the sensor is this far [m] from the last picked scan, or if enough of the ranges have
            changed by more than this.
        turn_rad: a scan is also picked if the sensor has turned by this much [rad] since the last picked scan.

    Returns:
        Indices of the picked scans, which include the first and the last scan.
    """
    poses, apart = odometry.at(scans.stamps_us), np.diff(scans.stamps_us)
    hurried = apart < _HURRIED * np.median(apart)
    picked = [0]
    for k in range(1, len(poses)):
        moved = se2.wrapped_between(poses[picked[-1]], poses[k])
        by_odometry = np.hypot(moved[0], moved[1]) >= path_m or abs(moved[2]) >= turn_rad
        share = _CHANGED_IN_HURRY if hurried[k - 1] else _CHANGED
        if by_odometry or _differ(scans[picked[-1]].returns, scans[k].returns, path_m, share):
            picked.append(k)
    if picked[-1] != len(poses) - 1:
        picked.append(len(poses) - 1)
    return picked


def _differ(a: Returns, b: Returns, least_m: float, share: float) -> bool:
    """Returns whether more than the given share of two scans' ranges differ by more than `least_m` [m] at equal azimuths."""
    if len(a) < 2 or not len(b):
        return False
    order = np.argsort(a.azimuths)
    off = np.abs(np.interp(b.azimuths, a.azimuths[order], a.ranges[order]) - b.ranges)
    return bool(np.mean(off > least_m) > share)
