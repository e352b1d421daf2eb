"""Computes published measures of map quality from the points of one window, for comparison with psi.

The measures need no ground truth. Their values depend on the place as much as on the trajectory, so that no measure alone
can judge a map. The neighbourhood of a point holds all points within `audit.radius_m` of that point. A sweep is one turn of
the sensor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.config import AuditConfig
from mqslam.core import se2

# Neighbourhoods of fewer points than this have no shape and are left out of the means.
_FEWEST_NEIGHBOURS = 5
# Log odds that a return adds to its cell of the evidence grid.
_HIT_LOG_ODDS = 0.85
# Log odds that a beam adds to each cell of the evidence grid that it passes through.
_MISS_LOG_ODDS = -0.4
# Largest absolute log odds of a cell of the evidence grid.
_LOG_ODDS_LIMIT = 3.5

_LEAST_M2: Final = 1e-6  # numerical [m^2]: added to variances, so that equal points have a finite entropy
_LARGEST: Final = 2e7  # largest grid [cells]: only points that are far off need a larger grid, which would show nothing


@dataclass(frozen=True, slots=True)
class Measures:
    """Measures of the map of one window; a low value means a crisp map.

    Args:
        map_entropy: mean differential entropy of the points' neighbourhoods [nat].
        plane_variance: mean, over the neighbourhoods, of the smallest variance along any direction [m^2].
        joint_entropy: mean, over the points, of the entropy of the neighbourhood in all sweeps minus the entropy of the
            neighbourhood in the point's own sweep [nat].
        grid_entropy: mean entropy of the cells that were seen, in a grid of the evidence that cells are occupied [nat].

    A measure is NaN if the window holds too few points to compute it. `grid_entropy` is also NaN if the points lie so far
    apart that the grid would need too much memory.
    """

    map_entropy: float
    plane_variance: float
    joint_entropy: float
    grid_entropy: float


def compute_measures(
    points: NDArray[np.float64], sweeps: NDArray[np.int64], sensors: NDArray[np.float64], settings: AuditConfig
) -> Measures:
    """Computes how crisp the map of a window is, by all measures of this module.

    Args:
        points: (N, 2) x, y [m], world frame.
        sweeps: (N,) number of the sweep that holds each point.
        sensors: (N, 2) position x, y of the sensor when it saw each point [m], world frame.
        settings: settings of the audit.

    Source: mean map entropy and mean plane variance are from Droeschel and Behnke, "Efficient continuous-time SLAM for 3D
    lidar-based online mapping", 2018; the difference of joint and separate entropy is from Adolfsson et al., "CorAl:
    Introspection for robust radar and lidar perception in diverse environments using differential entropy", 2022; the
    evidence grid is from Elfes, 1989.
    """
    pairs = cKDTree(points).query_pairs(settings.radius_m, output_type="ndarray")
    of_one_sweep = pairs[sweeps[pairs[:, 0]] == sweeps[pairs[:, 1]]]
    joint, least = _measure_shapes(points, pairs)
    separate, _ = _measure_shapes(points, of_one_sweep)
    both = np.isfinite(joint) & np.isfinite(separate)
    return Measures(
        map_entropy=_mean(joint),
        plane_variance=_mean(least),
        joint_entropy=_mean(joint[both] - separate[both]),
        grid_entropy=compute_grid_entropy(points, sensors, 0.5 * settings.radius_m),
    )


def compute_grid_entropy(points: NDArray[np.float64], sensors: NDArray[np.float64], cell_m: float) -> float:
    """Computes the mean entropy [nat] of the cells that the beams from the sensor to the points cross or end in.

    Args:
        points: (N, 2) x, y [m], world frame.
        sensors: (N, 2) position x, y of the sensor when it saw each point [m], world frame.
        cell_m: side of the grid's cells [m].

    Returns:
        The entropy; NaN if there are no points, or if the grid would need too much memory.
    """
    if len(points) == 0:
        return float("nan")
    lowest = np.minimum(points.min(axis=0), sensors.min(axis=0))
    ends, begins = (points - lowest) / cell_m, (sensors - lowest) / cell_m
    columns, rows = np.ceil(np.maximum(ends, begins).max(axis=0)) + 1.0
    if columns * rows > _LARGEST:
        return float("nan")
    odds, seen = accumulate_evidence(begins, ends, (int(columns), int(rows)))
    p = 1.0 / (1.0 + np.exp(-odds[seen]))
    return float(np.mean(-p * np.log(p) - (1.0 - p) * np.log(1.0 - p)))


@nb.njit(cache=True, nogil=True)
def accumulate_evidence(
    begins: NDArray[np.float64], ends: NDArray[np.float64], shape: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Computes the log odds that each cell of a grid is occupied: a crossing beam lowers the odds, a beam's end raises them.

    Args:
        begins: (N, 2) start x, y of each beam, in cells from the grid's corner.
        ends: (N, 2) end x, y of each beam, in cells from the grid's corner.
        shape: number of columns (along x) and number of rows (along y).

    Returns:
        The log odds (columns, rows), and whether a beam crosses each cell or ends in it (columns, rows).
    """
    odds = np.zeros(shape)
    seen = np.zeros(shape, np.bool_)
    for i in range(len(ends)):
        dx, dy = ends[i, 0] - begins[i, 0], ends[i, 1] - begins[i, 1]
        steps = int(np.ceil(max(abs(dx), abs(dy))))
        for k in range(steps):
            f = k / steps
            x, y = int(begins[i, 0] + f * dx), int(begins[i, 1] + f * dy)
            seen[x, y] = True
            odds[x, y] = max(odds[x, y] + _MISS_LOG_ODDS, -_LOG_ODDS_LIMIT)
        x, y = int(ends[i, 0]), int(ends[i, 1])
        seen[x, y] = True
        odds[x, y] = min(odds[x, y] + _HIT_LOG_ODDS, _LOG_ODDS_LIMIT)
    return odds, seen


def locate_sensors(turns: NDArray[np.float64], numbers: NDArray[np.float64], poses: se2.Array) -> NDArray[np.float64]:
    """Interpolates the sensor's positions between its poses at the starts of sweeps.

    Args:
        turns: (N,) times of the wanted positions, in sweeps: 2.5 lies midway between the starts of sweeps 2 and 3.
        numbers: (S,) time at which each sweep starts, in sweeps, increasing.
        poses: (S, 3) pose of the sensor at the start of each sweep: x, y [m], yaw [rad], world frame.

    Returns:
        (N, 2) positions x, y [m], world frame.
    """
    return np.column_stack([np.interp(turns, numbers, poses[:, 0]), np.interp(turns, numbers, poses[:, 1])])


def _measure_shapes(
    points: NDArray[np.float64], pairs: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns the entropy (N,) [nat] and the smallest variance (N,) [m^2] of each point's neighbourhood.

    Args:
        points: (N, 2) x, y [m].
        pairs: (M, 2) indices of two points that are neighbours; each pair is given once.

    Both are NaN for a neighbourhood of fewer than `_FEWEST_NEIGHBOURS` points.
    """
    a, b = pairs.T
    offset = points[b] - points[a]
    n = len(points)

    def add_up(at_a: NDArray[np.float64], at_b: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.bincount(a, at_a, n) + np.bincount(b, at_b, n))

    x, y = offset.T
    count = 1.0 + add_up(np.ones(len(a)), np.ones(len(a)))
    mx, my = add_up(x, -x) / count, add_up(y, -y) / count
    xx = add_up(x * x, x * x) / count - mx * mx + _LEAST_M2
    yy = add_up(y * y, y * y) / count - my * my + _LEAST_M2
    xy = add_up(x * y, x * y) / count - mx * my
    determinant = np.maximum(xx * yy - xy * xy, _LEAST_M2**2)
    half = 0.5 * (xx + yy)
    least = half - np.sqrt(np.maximum(half * half - determinant, 0.0))
    entropy = np.log(2.0 * np.pi * np.e) + 0.5 * np.log(determinant)
    few = count < _FEWEST_NEIGHBOURS
    entropy[few], least[few] = np.nan, np.nan
    return entropy, least


def _mean(values: NDArray[np.float64]) -> float:
    """Returns the mean of the finite values among `values` (N,); NaN if no value is finite."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")
