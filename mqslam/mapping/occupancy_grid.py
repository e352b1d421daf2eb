"""A point map as the occupancy grid that nav2's map_server loads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.config import MapConfig
from mqslam.core.point_map import OccupancyGrid

MAX_SIDE = 20_000
"""Longest side of a grid [cells]: a limit on memory, which single returns far away would otherwise break."""


def make_occupancy_grid(points: NDArray[np.float64], settings: MapConfig) -> OccupancyGrid:
    """Returns the cells that hold so many returns that something stands there.

    They hold at least as many returns as the geometric middle between one stray return and a well-seen cell, so that the
    threshold follows the speed of the drive and the turn rate of the radar.

    Args:
        points: (N, 2) [m], world frame.
        settings: of the map; its cells are made larger where the grid would be over MAX_SIDE cells long.

    Returns:
        The grid around the points; one free-standing empty cell where there are none.
    """
    resolution = settings.cell_m
    if len(points) == 0:
        return OccupancyGrid(np.zeros((1, 1), dtype=np.bool_), resolution, (0.0, 0.0))
    lowest, highest = points.min(axis=0), points.max(axis=0)
    resolution = max(resolution, float((highest - lowest).max()) / (MAX_SIDE - 2))
    first = np.floor(lowest / resolution)
    columns, rows = (np.floor(highest / resolution) - first).astype(np.int64) + 1
    column, row = (np.floor(points / resolution) - first).astype(np.int64).T
    cells, counts = np.unique(row * columns + column, return_counts=True)
    occupied = np.zeros(int(rows * columns), dtype=np.bool_)
    occupied[cells[counts >= np.sqrt(np.percentile(counts, settings.well_seen))]] = True
    x, y = (first * resolution).tolist()
    return OccupancyGrid(occupied.reshape(rows, columns), resolution, (x, y))
