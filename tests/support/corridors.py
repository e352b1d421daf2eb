"""Two passes of a lidar through a corridor with niches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from support.laser_drive import PERIOD_S, look

from mqslam.backend.loops.passes import TrackedRun
from mqslam.backend.problem import Problem
from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.core.scans import Scans

PASS = 80
"""Number of scans of each pass, one metre apart."""


def build_corridor(seed: int) -> NDArray[np.float64]:
    """Returns the walls (W, 4) of a straight corridor with shallow niches on both sides, at irregular distances."""
    random, walls = np.random.default_rng(seed), []
    for side in (-3.0, 3.0):
        deep, last, begin = 1.12 * side, -100.0, -60.0
        while begin < 160.0:
            begin += 14.0 * random.uniform(0.6, 1.4)
            end = begin + 2.4
            walls += [
                [last, side, begin, side],
                [begin, side, begin, deep],
                [begin, deep, end, deep],
                [end, deep, end, side],
            ]
            last = begin = end
        walls.append([last, side, 300.0, side])
    return np.array(walls)


def drive_twice(walls: NDArray[np.float64], unit_m: float | None, *, back: bool = False) -> TrackedRun:
    """Returns two passes along a corridor of `PASS` scans each, the later one in the other direction if asked for."""
    along = np.arange(PASS, dtype=np.float64)
    first = np.column_stack([along, np.zeros((PASS, 2))])
    second = np.column_stack([along + 0.37, 0.8 * np.sin(along / 7.0), np.zeros(PASS)])
    if back:
        second = second[::-1] + np.array([0.0, 0.0, np.pi])
    poses = np.vstack([first, second])
    scans = tuple(look(walls, pose, PERIOD_S * k, k) for k, pose in enumerate(poses))
    return TrackedRun.of(Scans(scans, 0, PERIOD_S, unit_m), poses)


def join_passes(drive: TrackedRun, off: tuple[float, ...], sigmas: tuple[float, ...]) -> Problem:
    """Returns the true motions of two passes, of which the motion between the passes is off.

    Args:
        drive: the passes.
        off: (3,) the error of this motion [m, m, rad].
        sigmas: (3,) its standard deviations [m, m, rad].
    """
    motions = se2.between(drive.poses[:-1], drive.poses[1:])
    motions[PASS - 1] += off
    measurements = []
    for k, motion in enumerate(motions):
        stated = sigmas if k == PASS - 1 else (0.01, 0.01, 0.001)
        times = float(drive.times[k]), float(drive.times[k + 1])
        measurements.append(Measurement(*times, motion, np.diag(np.square(stated))))
    return Problem(measurements, [])


def find_errors(drive: TrackedRun, poses: se2.Array, pairs: list[tuple[int, int]]) -> se2.Array:
    """Returns the errors (N, 3) [m, m, rad] of the relative poses of N pairs of scans, given the poses of all scans."""
    earlier, later = np.array(pairs).T
    errors = se2.between(poses[earlier], poses[later]) - se2.between(drive.poses[earlier], drive.poses[later])
    return np.column_stack([errors[:, :2], se2.wrap(errors[:, 2])])
