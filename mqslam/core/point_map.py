"""Maps: returns placed in the world frame by a trajectory, occupancy grids, and point clouds with stamps of any origin."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.statistics import pick_evenly
from mqslam.core.stored import make_stored, release

_BLOCK: Final = 200_000  # points of a map that are in memory at a time; no result depends on this number
_LOOKED_AT: Final = 1_000_000  # thinning considers at most this many points, evenly spread over the map's time
# smallest cell [m], and ratio of largest to smallest possible cell at which `_pick_one_per_cell` ends its search
_SMALLEST_CELL_M: Final = 1e-3
_CELL_RATIO: Final = 1.05


@dataclass(frozen=True, slots=True)
class PointMap:
    """A map: returns as points in the world frame, each with its share of the score.

    Large arrays may lie in memory-mapped files.

    Args:
        points: (N, 2) [m], world frame.
        times: (N,) [s] since the recording's start.
        intensities: (N,) received power, 0..255.
        psi: (N,) share of each point in the map's score; for a point that is not matched, a fixed cost.
        matched: (N,) bool, whether the point has a neighbour that the sensor saw about one turn or more before or after it.
    """

    points: NDArray[np.float64]
    times: NDArray[np.float64]
    intensities: NDArray[np.float64]
    psi: NDArray[np.float64]
    matched: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.points)

    @property
    def psi_per_point(self) -> float | None:
        """Score per point, including the cost of points that are not matched; None without points."""
        return self.psi_total / len(self) if len(self) else None

    @property
    def psi_total(self) -> float:
        """Score of the map: the sum over all points."""
        return sum((float(block.psi.sum()) for block in self.blocks()), 0.0)

    @property
    def matched_share(self) -> float | None:
        """Share of the points that are matched, 0..1; None without points."""
        return sum(int(block.matched.sum()) for block in self.blocks()) / len(self) if len(self) else None

    def blocks(self) -> Iterator[PointMap]:
        """Yields the map in blocks of successive points, and releases each block from memory before the next one."""
        for begin in range(0, len(self), _BLOCK):
            yield self.take(slice(begin, begin + _BLOCK))
            release(self.points, self.times, self.intensities, self.psi, self.matched)

    def carry(self, frame: se2.Array) -> PointMap:
        """Returns the map in a new world frame, in which the present frame has the pose `frame` (3,) [m, m, rad]."""
        points, begin = make_stored(self.points.shape), 0
        for block in self.blocks():
            points[begin : begin + len(block)] = se2.transform(frame, block.points)
            begin += len(block)
            release(points)
        return replace(self, points=points)

    @classmethod
    def empty(cls) -> PointMap:
        """Returns a map without points."""
        return cls(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0), np.empty(0, dtype=np.bool_))

    def take(self, chosen: NDArray[np.int64] | slice) -> PointMap:
        """Returns a map of only the points with these indices (M,), or of only a slice of the points."""
        return PointMap(
            self.points[chosen], self.times[chosen], self.intensities[chosen], self.psi[chosen], self.matched[chosen]
        )


def pick_thinned(points: NDArray[np.float64], most: int) -> NDArray[np.int64]:
    """Returns the indices of at most `most` points that represent a map for display.

    A map with more points is thinned to one point per cell of about the finest raster with at most `most` occupied cells.
    Of a map with more than a million points, only a million, evenly spread over its time, are considered.

    Args:
        points: (N, 2) [m].
        most: largest number of points to pick.
    """
    if len(points) <= most:
        return np.arange(len(points))
    looked_at = pick_evenly(len(points), _LOOKED_AT)
    picked = looked_at[_pick_one_per_cell(points[looked_at], most)]
    release(points)
    return picked


def _pick_one_per_cell(points: NDArray[np.float64], most: int) -> NDArray[np.int64]:
    """Returns the index of one of the points (N, 2) per cell of the finest raster with at most `most` occupied cells."""
    order = np.random.default_rng(0).permutation(len(points))  # to keep a random point of each cell, not the earliest one
    shuffled = (points - points.min(axis=0))[order]
    low, high = _SMALLEST_CELL_M, float(np.ptp(points, axis=0).max()) + _SMALLEST_CELL_M
    while high > _CELL_RATIO * low:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if len(find_first_of_cells(shuffled, middle, most)) > most else (low, middle)
    return np.sort(order[find_first_of_cells(shuffled, high, most)])


@nb.njit(cache=True, nogil=True)
def find_first_of_cells(points: NDArray[np.float64], cell: float, most: int) -> NDArray[np.int64]:
    """Returns the index of the first point in each occupied cell of a raster, at most `most` + 1 of them.

    Args:
        points: (N, 2) [m], not negative.
        cell: side of a cell [m].
        most: the search ends once more cells than this are found to be occupied.
    """
    room = 4
    while room < 4 * most:
        room *= 2
    taken = np.full((room, 2), -1, np.int64)  # a hash table with linear probing: column and row of each occupied cell
    first = np.empty(most + 1, np.int64)
    count = 0
    for k in range(len(points)):
        column, row = int(points[k, 0] / cell), int(points[k, 1] / cell)
        place = (column * 73_856_093 ^ row * 19_349_663) & (room - 1)
        while taken[place, 0] >= 0 and (taken[place, 0] != column or taken[place, 1] != row):
            place = (place + 1) & (room - 1)
        if taken[place, 0] < 0:
            taken[place, 0], taken[place, 1] = column, row
            first[count] = k
            count += 1
            if count > most:
                break
    return first[:count]


@dataclass(frozen=True, slots=True)
class OccupancyGrid:
    """A grid that marks the cells in which the sensor saw something.

    Args:
        occupied: (H, W) bool, row 0 at the lowest y, column 0 at the lowest x.
        resolution: side of a cell [m].
        origin: x, y [m] of the lower left corner of cell (0, 0), world frame.
        free: (H, W) bool, cells that a lidar's beams crossed and that are therefore empty; None for a radar, whose returns
            do not show empty cells.
    """

    occupied: NDArray[np.bool_]
    resolution: float
    origin: tuple[float, float]
    free: NDArray[np.bool_] | None = None


@dataclass(frozen=True, slots=True)
class TimedCloud:
    """A planar point cloud with one stamp per point, ordered by time.

    Args:
        path: the file that the cloud was read from.
        points: (N, 2) [m], world frame.
        stamps_us: (N,) int64 [us], not decreasing, in the file's own clock.
        notes: sentences for the user on how the file was read.
        scan_us: usual duration of a scan [us], which only maps written by mqslam state; None for other files.
        is_of_lidar: whether the file says that a lidar has seen the points, as maps of lidars written by mqslam do.
    """

    path: Path
    points: NDArray[np.float64]
    stamps_us: NDArray[np.int64]
    notes: tuple[str, ...]
    scan_us: int | None = None
    is_of_lidar: bool = False

    @property
    def is_of_radar(self) -> bool:
        """Whether the points count as a radar's: true for maps that mqslam wrote and did not mark as a lidar's."""
        return self.scan_us is not None and not self.is_of_lidar

    def __len__(self) -> int:
        return len(self.points)
