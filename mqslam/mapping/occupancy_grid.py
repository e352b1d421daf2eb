"""Makes an occupancy grid of a point map, for nav2's map_server, and marks its free cells by the beams of a lidar."""

from __future__ import annotations

from dataclasses import replace

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.keyframes import Keyframes
from mqslam.core.point_map import OccupancyGrid
from mqslam.core.scans import Scans
from mqslam.core.stored import make_stored, release

# The number of returns in a well-seen cell is this percentile of the numbers of returns in the cells that hold any.
_WELL_SEEN = 99.0

MAX_SIDE = 20_000
"""Longest side of a grid [cells]. It limits memory, since a single return far away could make the grid very large."""
_BLOCK = 200_000  # number of points or cells that are processed at a time: affects memory only


def make_occupancy_grid(points: NDArray[np.float64], cell_m: float) -> OccupancyGrid:
    """Makes an occupancy grid of the points: cells with enough returns are occupied.

    A cell is occupied if it holds at least sqrt(n) returns, where n is the `_WELL_SEEN` percentile of the counts of returns
    in cells that hold any. Between n and the single return that noise leaves, sqrt(n) is the geometric mean. Since n depends
    on how fast the vehicle drives and the sensor turns, so does the threshold.

    Args:
        points: (N, 2) x, y [m], world frame.
        cell_m: side of a cell [m]. The cells are made larger if the grid would be more than MAX_SIDE cells long.

    Returns:
        The grid around the points; a single cell that is not occupied if there are no points.
    """
    resolution = cell_m
    if len(points) == 0:
        return OccupancyGrid(np.zeros((1, 1), dtype=np.bool_), resolution, (0.0, 0.0))
    parts = [slice(begin, begin + _BLOCK) for begin in range(0, len(points), _BLOCK)]
    extremes = np.array([(points[part].min(axis=0), points[part].max(axis=0)) for part in parts])
    lowest, highest = extremes[:, 0].min(axis=0), extremes[:, 1].max(axis=0)
    resolution = max(resolution, float((highest - lowest).max()) / (MAX_SIDE - 2))
    first = np.floor(lowest / resolution)
    columns, rows = (np.floor(highest / resolution) - first).astype(np.int64) + 1
    cells, counts = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    for part in parts:
        column, row = (np.floor(points[part] / resolution) - first).astype(np.int64).T
        here, seen = np.unique(row * columns + column, return_counts=True)
        where = np.searchsorted(cells, here)
        is_known = where < np.searchsorted(cells, here, side="right")
        counts[where[is_known]] += seen[is_known]
        cells, counts = (np.insert(a, where[~is_known], b[~is_known]) for a, b in ((cells, here), (counts, seen)))
        release(points)
    occupied = make_stored((int(rows * columns),), np.bool_)
    filled = cells[counts >= np.sqrt(np.percentile(counts, _WELL_SEEN))]
    for begin in range(0, len(filled), _BLOCK):
        occupied[filled[begin : begin + _BLOCK]] = True
        release(occupied)
    x, y = (first * resolution).tolist()
    return OccupancyGrid(occupied.reshape(rows, columns), resolution, (x, y))


def mark_free(grid: OccupancyGrid, scans: Scans, poses: se2.Array) -> OccupancyGrid:
    """Returns the grid with its free cells marked: cells that are not occupied and that a beam of a lidar passes through.

    Args:
        grid: grid with the occupied cells.
        scans: scans of the lidar; the lidar is taken to stand still during each scan.
        poses: (N, 3) pose of the lidar at the start of each scan: x, y [m], yaw [rad], in the grid's frame.
    """
    free = np.zeros(grid.occupied.shape, dtype=np.bool_)
    for scan, pose in zip(scans, poses, strict=True):
        seen = scan.returns
        starts = np.tile(pose[:2], (len(seen), 1))
        _pass_through(free, seen.ranges, _point(pose[2] + seen.azimuths), starts, grid.resolution, grid.origin)
    return replace(grid, free=free & ~grid.occupied)


def mark_free_by_keyframes(grid: OccupancyGrid, keyframes: Keyframes) -> OccupancyGrid:
    """Returns the grid with its free cells marked, as `mark_free` does, but by the beams of a lidar's keyframes.

    Args:
        grid: grid with the occupied cells.
        keyframes: keyframes of a lidar's map, with their poses in the grid's frame.
    """
    free = np.zeros(grid.occupied.shape, dtype=np.bool_)
    for number, (pose, (begin, end)) in enumerate(zip(keyframes.poses, keyframes.rows.tolist(), strict=True)):
        ranges, rays = (keyframes.points[name][begin:end].astype(np.float64) for name in ("range", "ray"))
        starts = se2.transform(pose, keyframes.find_origins(number))
        _pass_through(free, ranges, _point(pose[2] + rays), starts, grid.resolution, grid.origin)
    release(keyframes.points)
    return replace(grid, free=free & ~grid.occupied)


def _point(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns unit vectors (N, 2) of directions (N,) [rad]."""
    return np.column_stack([np.cos(directions), np.sin(directions)])


@nb.njit(cache=True, nogil=True)
def _pass_through(
    free: NDArray[np.bool_],
    ranges: NDArray[np.float64],
    beams: NDArray[np.float64],
    starts: NDArray[np.float64],
    cell_m: float,
    origin: tuple[float, float],
) -> None:
    """Marks in `free` (H, W) the cells that beams pass through, up to one cell before each beam's end.

    Beams begin at `starts` (N, 2) [m], point along the unit vectors `beams` (N, 2), and are `ranges` (N,) [m] long. Starts,
    unit vectors and the `origin` x, y [m] are in the frame of the grid, which is laid out as in `OccupancyGrid`.
    """
    rows, columns = free.shape
    for i in range(len(ranges)):
        for n in range(int(2.0 * (ranges[i] / cell_m - 1.0))):
            way = 0.5 * n * cell_m
            column = int(np.floor((starts[i, 0] + way * beams[i, 0] - origin[0]) / cell_m))
            row = int(np.floor((starts[i, 1] + way * beams[i, 1] - origin[1]) / cell_m))
            if 0 <= row < rows and 0 <= column < columns:
                free[row, column] = True
