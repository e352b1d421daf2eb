"""Two passes of a lidar through a corridor with niches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from support.laser_drive import PERIOD_S, look

from mqslam.backend.loops.passes import TrackedRun
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
