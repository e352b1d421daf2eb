"""A point map as the occupancy image that nav2's map_server loads."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from mqslam.core.point_map import PointMap
from mqslam.execution.files import write_text, written_whole

MAX_SIDE = 20_000
_OCCUPIED = 0
_UNKNOWN = 205


@dataclass(frozen=True, slots=True)
class OccupancyGrid:
    """Cells in which the radar saw something.

    Args:
        occupied: (H, W) bool, row 0 at the lowest y, column 0 at the lowest x.
        resolution: side of a cell [m].
        origin: x, y [m] of the lower left corner of cell (0, 0), world frame.
    """

    occupied: NDArray[np.bool_]
    resolution: float
    origin: tuple[float, float]


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


def write_nav2_map(folder: Path, pointmap: PointMap, resolution: float = 0.2) -> None:
    """Write `map.pgm` and `map.yaml` into a folder, in the format of nav2's and ROS 1's map_server.

    A cell is occupied or unknown, never free: that a radar got no return from a place does not show that the place is
    empty. Planners need `allow_unknown: true` on such a map.

    Args:
        folder: an existing folder.
        pointmap: the map to write.
        resolution: side of a cell [m], see `occupancy_grid`.

    Raises:
        OutputError: a file cannot be written.
    """
    grid = occupancy_grid(pointmap.points, resolution)
    height, width = grid.occupied.shape
    with written_whole(folder / "map.pgm") as aside, aside.open("wb") as file:
        file.write(f"P5\n{width} {height}\n255\n".encode())
        file.write(np.where(grid.occupied[::-1], np.uint8(_OCCUPIED), np.uint8(_UNKNOWN)).tobytes())
    # map_server reads a pixel p as the occupancy (255 - p) / 255: 205 gives 0.19608, just above free_thresh.
    settings = {
        "image": "map.pgm",
        "mode": "trinary",
        "resolution": grid.resolution,
        "origin": [*grid.origin, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    write_text(folder / "map.yaml", yaml.safe_dump(settings, sort_keys=False, default_flow_style=None))
