"""A point map as the occupancy image that nav2's map_server loads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.core.point_map import OccupancyGrid

MAX_SIDE = 20_000


def occupancy_grid(points: NDArray[np.float64], resolution: float = 0.2) -> OccupancyGrid:
    """Cells with at least as many returns as the geometric middle between one stray return and a well-seen cell.

    A well-seen cell holds the 99th percentile of the counts of the cells that hold any, so the threshold follows the
    speed of the drive and the turn rate of the radar: it is the square root of that count.

    Args:
        points: (N, 2) [m], world frame.
        resolution: side of a cell [m]; made larger where the grid would be over MAX_SIDE cells long.

    Returns:
        The grid around the points; one free-standing empty cell where there are none.
    """
    if len(points) == 0:
        return OccupancyGrid(np.zeros((1, 1), dtype=np.bool_), resolution, (0.0, 0.0))
    lowest, highest = points.min(axis=0), points.max(axis=0)
    resolution = max(resolution, float((highest - lowest).max()) / (MAX_SIDE - 2))
    first = np.floor(lowest / resolution)
    columns, rows = (np.floor(highest / resolution) - first).astype(np.int64) + 1
    column, row = (np.floor(points / resolution) - first).astype(np.int64).T
    cells, counts = np.unique(row * columns + column, return_counts=True)
    occupied = np.zeros(int(rows * columns), dtype=np.bool_)
    occupied[cells[counts >= np.sqrt(np.percentile(counts, 99))]] = True
    x, y = (first * resolution).tolist()
    return OccupancyGrid(occupied.reshape(rows, columns), resolution, (x, y))
