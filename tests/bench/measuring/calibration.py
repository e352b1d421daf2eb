"""How well measurements know their own errors: the squared error of each, normalised by its covariance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from bench.measuring.scorer import headings, place, read_trajectory, wrap
from numpy.typing import NDArray

_DEGREES = 3  # of freedom: x, y and yaw


def measure_nees(measurements: Path, stamps: Path, truth: Path) -> NDArray[np.float64]:
    """Returns the normalised squared errors (N,) of measurements over their degrees of freedom: 1 on average if right.

    Args:
        measurements: table of relative motions with their covariances.
        stamps: TUM file whose first stamp is the start of the recording.
        truth: TUM file.
    """
    table = np.genfromtxt(measurements, delimiter=",", names=True, usecols=range(11), ndmin=1)
    start = read_trajectory(stamps).timestamps[0]
    true = read_trajectory(truth)
    first, last = (place(true, start + table[name]) for name in ("t0", "t1"))
    yaw, turned = headings(first), headings(last)
    dx, dy = (last.positions_xyz - first.positions_xyz)[:, :2].T
    moved = np.c_[np.cos(yaw) * dx + np.sin(yaw) * dy, np.cos(yaw) * dy - np.sin(yaw) * dx, turned - yaw]
    error = np.c_[table["dx"], table["dy"], table["dyaw"]] - moved
    error[:, 2] = wrap(error[:, 2])
    xx, xy, xw, yy, yw, ww = (table[f"cov_{name}"] for name in ("xx", "xy", "xyaw", "yy", "yyaw", "yawyaw"))
    covariance = np.moveaxis(np.array([[xx, xy, xw], [xy, yy, yw], [xw, yw, ww]]), 2, 0)
    normalised = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0])
    return normalised / _DEGREES
