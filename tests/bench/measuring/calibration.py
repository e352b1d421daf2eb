"""How well measurements and poses know their own errors: the squared error of each, normalised by its covariance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from bench.measuring.scorer import headings, place, read_trajectory, relative, wrap
from numpy.typing import NDArray

_DEGREES = 3  # of freedom: x, y and yaw
_APART = 30  # scans between the poses that are judged: the errors of nearer ones are nearly the same


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
    return _normalise(error, table)


def measure_pose_nees(run: Path, truth: Path) -> float | None:
    """Returns the mean normalised squared error of every 30th pose over its degrees of freedom; None where it is not known.

    A pose is held against the truth relative to the first pose, which the graph holds where it is: so the marginal
    covariance of the pose alone is that of its error. Between two poses that are both free it would take their joint one.

    Args:
        run: folder with `trajectory.tum` and, where the covariances are known, `covariances.csv`.
        truth: TUM file.
    """
    if not (run / "covariances.csv").is_file():
        return None
    table = np.genfromtxt(run / "covariances.csv", delimiter=",", names=True, ndmin=1)
    track = read_trajectory(run / "trajectory.tum")
    true = place(read_trajectory(truth), track.timestamps)
    judged = range(_APART, track.num_poses, _APART)
    if not judged:
        return None
    error = np.array([relative(track, 0, k) - relative(true, 0, k) for k in judged])
    error[:, 2] = wrap(error[:, 2])
    return float(_normalise(error, table[judged]).mean())


def _normalise(error: NDArray[np.float64], table: NDArray[np.void]) -> NDArray[np.float64]:
    """Returns the squared errors (N,) of motions (N, 3), normalised by the covariances of a table's rows."""
    xx, xy, xw, yy, yw, ww = (table[f"cov_{name}"] for name in ("xx", "xy", "xyaw", "yy", "yyaw", "yawyaw"))
    covariance = np.moveaxis(np.array([[xx, xy, xw], [xy, yy, yw], [xw, yw, ww]]), 2, 0)
    normalised = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0])
    return np.asarray(normalised / _DEGREES)
