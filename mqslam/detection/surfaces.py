"""The first stage of a lidar's run: turns ranges along beams into points that lie evenly on the surfaces that were seen.

Beams are spread evenly over angles, not over surfaces: a wall beside the sensor takes hundreds of beams, and a wall far away
a few. Two scans of one wall from different places therefore hold different points of it. Between two beams that hit the same
surface the surface is known, too; points at equal distances along it are the same from wherever it is seen.
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

# Angle between a beam and the surface's normal up to which two neighbouring beams that hit it are taken to hit one surface.
_STEEPEST_RAD: Final = np.radians(75.0)
# Steps between beams that are wider than this many usual steps have a beam without a return between them.
_WIDEST_STEP = 1.5
# Two neighbouring beams always hit the same surface if their returns are this near to each other, in units of the spacing.
_NEAR = 1.0
# Usual range of what a radar sees in a street [m].
_USUAL_RANGE_M = 20.0
_LEAST_M: Final = 0.01  # least unit [m], to which it is rounded
# Distance between points, and way after which a scan is taken, in the recording's unit; turn after which one is taken.
_SPACING, _PATH, _TURN_RAD = 0.25, 0.5, np.radians(5.0)
_CHANGED = 0.4  # share of ranges that differ once the sensor has moved
# Scans that follow each other within this share of the usual time were held up on their way: odometry at their stamps does
# not tell whether the sensor moved between them. This share of ranges that differ is then enough.
_HURRIED, _CHANGED_IN_HURRY = 0.5, 0.1


def spread_evenly(scan: Scan, step_rad: float, spacing_m: float) -> Scan:
    """Returns a scan whose returns lie at equal distances along the surfaces that its beams hit.

    Args:
        scan: a lidar's scan, whose returns are in the order of their azimuths or of their times.
        step_rad: angle between neighbouring beams [rad].
        spacing_m: distance between the points [m].
    """
    seen = scan.returns
    if not len(seen):
        return scan
    table = np.column_stack([seen.ranges, seen.azimuths, seen.times, seen.intensities])
    spread = _spread(table, _WIDEST_STEP * step_rad, 1.0 / np.cos(_STEEPEST_RAD), spacing_m)
    return Scan(scan.t0, scan.t1, Returns(*np.ascontiguousarray(spread.T)))


@nb.njit(cache=True, nogil=True)
def _spread(table: NDArray[np.float64], widest: float, steepest: float, spacing: float) -> NDArray[np.float64]:
    """Spreads returns (N, 4), as range, azimuth, time and intensity, along the lines that join neighbours on one surface."""
    n = len(table)
    kept = np.empty((n + 1, 4))
    rows = [kept[0]]
    rows.clear()
    left = 0.0  # way along the surface to the next point
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
    """Returns the angle from an azimuth [rad] to the direction of a point, within half a turn."""
    return float((np.arctan2(y, x) - azimuth + np.pi) % (2.0 * np.pi) - np.pi)


def find_step(scans: Scans) -> float:
    """Returns the angle between neighbouring beams [rad]: the usual angle between successive returns of a scan."""
    steps = [np.abs(np.diff(scan.returns.azimuths)) for scan in scans if len(scan.returns) > 1]
    return float(np.median(np.concatenate(steps))) if steps else 0.0


def prepare(recording: LidarRecording, odometry: Trajectory | None, unit_m: float | None = None) -> LidarRecording:
    """Returns a lidar's recording as it is solved: points lie evenly, and scans at rest are left out.

    Args:
        recording: the recording as it was read.
        odometry: poses of the sensor, or None: all scans are kept then.
        unit_m: length [m] that is to what the lidar sees as a metre is to what a radar sees in a street; None measures it.
    """
    unit_m, step = measure_unit(recording.scans) if unit_m is None else unit_m, find_step(recording.scans)
    kept = recording
    if odometry is not None:
        kept = recording.take(pick_moving(recording.scans, odometry, _PATH * unit_m, _TURN_RAD))
    even = tuple(spread_evenly(scan, step, _SPACING * unit_m) for scan in kept.scans)
    scans = replace(kept.scans, scans=even, unit_m=unit_m)
    return replace(kept, scans=scans, every_us=recording.stamps_us, odometry=odometry)


def measure_unit(scans: Scans) -> float:
    """Returns the length [m] that is to what a lidar sees as a metre is to what a radar sees in a street.

    It follows from the usual range of what is seen. Every beam counts by the length of surface that it stands for.
    """
    ranges = np.sort(np.concatenate([scan.returns.ranges for scan in scans]))
    surface = np.cumsum(ranges)
    usual = float(ranges[np.searchsorted(surface, 0.5 * surface[-1])])
    return float(np.round(usual / _USUAL_RANGE_M, 2)) or _LEAST_M


def pick_moving(scans: Scans, odometry: Trajectory, path_m: float, turn_rad: float) -> list[int]:
    """Picks the scans between which a robot has moved or turned; scans at rest add nothing.

    Odometry tells where the robot has moved. Where wheels slip or stamps are wrong, the ranges themselves tell it. Stamps of
    scans that were held up are wrong: such scans arrive in a burst, in which odometry seems to stand still.

    Args:
        scans: all scans.
        odometry: poses of the sensor.
        path_m: a scan is taken after this distance [m] from the last one that was taken.
        turn_rad: or after this turn [rad].
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
    """Returns whether more than a share of the ranges of two scans differ by more than `least_m`."""
    if len(a) < 2 or not len(b):
        return False
    order = np.argsort(a.azimuths)
    off = np.abs(np.interp(b.azimuths, a.azimuths[order], a.ranges[order]) - b.ranges)
    return bool(np.mean(off > least_m) > share)
