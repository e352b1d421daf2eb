"""The field's measures of a map without ground truth, for comparison with psi: each takes one window's points.

Their values depend on the place as much as on the trajectory, so that none of them judges a map by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.core import se2

_FEWEST = 5  # points a neighbourhood must hold to have a shape
_LEAST_M2 = 1e-6  # added to variances, so that points on one spot have a finite entropy [m^2]
_LARGEST = 2e7  # cells of a grid; a window that is spread wider is torn far apart, and its grid says nothing
_HIT, _MISS, _MOST = 0.85, -0.4, 3.5  # log odds of a cell for a return in it and for a beam through it, and their bound


@dataclass(frozen=True, slots=True)
class Measures:
    """Measures of one window's map; low is crisp.

    Args:
        map_entropy: mean map entropy: mean differential entropy of the neighbourhoods [nat].
        plane_variance: mean smallest variance of the neighbourhoods [m^2].
        joint_entropy: mean difference between the entropy of a neighbourhood in all sweeps and in its point's own [nat].
        grid_entropy: entropy of the window's evidence grid per cell seen [nat].

    A measure is NaN where the window holds too few points for it, and the grid's where they lie too far apart.
    """

    map_entropy: float
    plane_variance: float
    joint_entropy: float
    grid_entropy: float


def measures(
    points: NDArray[np.float64], sweeps: NDArray[np.int64], sensors: NDArray[np.float64], radius_m: float, cell_m: float
) -> Measures:
    """All measures of a window.

    Args:
        points: (N, 2) m.
        sweeps: (N,) number of the sweep each point is of.
        sensors: (N, 2) m, where the sensor was when it saw each point.
        radius_m: radius of a neighbourhood [m].
        cell_m: side of the grid's cells [m].

    Source: mean map entropy and mean plane variance: Droeschel and Behnke, "Efficient continuous-time SLAM for 3D
    lidar-based online mapping", 2018; joint against separate entropy: Adolfsson et al., "CorAl: Introspection for robust
    radar and lidar perception in diverse environments using differential entropy", 2022; evidence grid: Elfes, 1989.
    """
    pairs = cKDTree(points).query_pairs(radius_m, output_type="ndarray")
    joint, least = _shapes(points, pairs)
    separate, _ = _shapes(points, pairs[sweeps[pairs[:, 0]] == sweeps[pairs[:, 1]]])
    both = np.isfinite(joint) & np.isfinite(separate)
    return Measures(
        map_entropy=_mean(joint),
        plane_variance=_mean(least),
        joint_entropy=_mean(joint[both] - separate[both]),
        grid_entropy=grid_entropy(points, sensors, cell_m),
    )


def grid_entropy(points: NDArray[np.float64], sensors: NDArray[np.float64], cell_m: float) -> float:
    """Entropy per cell [nat] of the evidence grid of beams from sensors (N, 2) to points (N, 2).

    It is NaN without points, and where the grid would not fit into a reasonable part of the memory.
    """
    if len(points) == 0:
        return float("nan")
    lowest = np.minimum(points.min(axis=0), sensors.min(axis=0))
    ends, begins = (points - lowest) / cell_m, (sensors - lowest) / cell_m
    columns, rows = np.ceil(np.maximum(ends, begins).max(axis=0)) + 1.0
    if columns * rows > _LARGEST:
        return float("nan")
    odds, seen = evidence(begins, ends, int(columns), int(rows))
    p = 1.0 / (1.0 + np.exp(-odds[seen]))
    return float(np.mean(-p * np.log(p) - (1.0 - p) * np.log(1.0 - p)))


@nb.njit(cache=True, nogil=True)
def evidence(
    begins: NDArray[np.float64], ends: NDArray[np.float64], columns: int, rows: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Log odds (columns, rows) that cells are occupied, and which have been seen, from beams in units of a cell."""
    odds = np.zeros((columns, rows))
    seen = np.zeros((columns, rows), np.bool_)
    for i in range(len(ends)):
        dx, dy = ends[i, 0] - begins[i, 0], ends[i, 1] - begins[i, 1]
        steps = int(np.ceil(max(abs(dx), abs(dy))))
        for k in range(steps):
            f = k / steps
            x, y = int(begins[i, 0] + f * dx), int(begins[i, 1] + f * dy)
            seen[x, y] = True
            odds[x, y] = max(odds[x, y] + _MISS, -_MOST)
        x, y = int(ends[i, 0]), int(ends[i, 1])
        seen[x, y] = True
        odds[x, y] = min(odds[x, y] + _HIT, _MOST)
    return odds, seen


def sensors_of(turns: NDArray[np.float64], numbers: NDArray[np.float64], poses: se2.Array) -> NDArray[np.float64]:
    """Where the sensor was (N, 2) [m] at turns (N,), from its poses (S, 3) at turns (S,)."""
    return np.column_stack([np.interp(turns, numbers, poses[:, 0]), np.interp(turns, numbers, poses[:, 1])])


def _shapes(points: NDArray[np.float64], pairs: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Entropy [nat] and smallest variance [m^2] of each point's neighbourhood, itself included; NaN where it holds few."""
    a, b = pairs.T
    offset = points[b] - points[a]
    n = len(points)

    def summed(at_a: NDArray[np.float64], at_b: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.bincount(a, at_a, n) + np.bincount(b, at_b, n))

    x, y = offset.T
    count = 1.0 + summed(np.ones(len(a)), np.ones(len(a)))
    mx, my = summed(x, -x) / count, summed(y, -y) / count
    xx = summed(x * x, x * x) / count - mx * mx + _LEAST_M2
    yy = summed(y * y, y * y) / count - my * my + _LEAST_M2
    xy = summed(x * y, x * y) / count - mx * my
    determinant = np.maximum(xx * yy - xy * xy, _LEAST_M2**2)
    half = 0.5 * (xx + yy)
    least = half - np.sqrt(np.maximum(half * half - determinant, 0.0))
    entropy = np.log(2.0 * np.pi * np.e) + 0.5 * np.log(determinant)
    few = count < _FEWEST
    entropy[few], least[few] = np.nan, np.nan
    return entropy, least


def _mean(values: NDArray[np.float64]) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")
