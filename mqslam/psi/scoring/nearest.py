"""The nearest of the points that a cell grid holds; SciPy's `cKDTree` is the readable twin.

A tree of a map that changes with every scan takes longer to build than it takes to search.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.psi.scoring.neighbours import CellGrid, find_first

_RINGS = 16  # rings of cells around a query beyond which all points are looked at: a matter of speed only


@nb.njit(cache=True, nogil=True, error_model="numpy")
def find_nearest(grid: CellGrid, queries: NDArray[np.float64], count: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Finds the points of a grid that are nearest to each query.

    Args:
        grid: at least so many points.
        queries: (N, 2) m.
        count: K, how many of the nearest points are asked for.

    Returns:
        Distances (N, K) [m], and indices (N, K) of the points as they were given to the grid, the nearest first.
    """
    points, order, rows, begins, corner, cell = grid
    squares, indices = np.full((len(queries), count), np.inf), np.empty((len(queries), count), np.int64)
    columns = len(begins) - 1
    for i in range(len(queries)):
        x, y = queries[i, 0], queries[i, 1]
        along, up = (x - corner[0]) / cell, (y - corner[1]) / cell
        ring, inside = 0, abs(along) < columns + _RINGS and abs(up) < 2.0**31
        middle, level = (int(np.floor(along)), int(np.floor(up))) if inside else (0, 0)
        edge = cell * min(along - middle, middle + 1.0 - along, up - level, level + 1.0 - up)
        while inside and ring <= _RINGS:
            for column in range(max(middle - ring, 0), min(middle + ring, columns - 1) + 1):
                step = 1 if abs(column - middle) == ring else max(2 * ring, 1)  # within the ring a column has two
                for row in range(level - ring, level + ring + 1, step):
                    k = find_first(rows, begins[column], begins[column + 1], row)
                    while k < begins[column + 1] and rows[k] == row:
                        _insert(squares[i], indices[i], (points[k, 0] - x) ** 2 + (points[k, 1] - y) ** 2, order[k])
                        k += 1
            if squares[i, count - 1] <= (edge + ring * cell) ** 2:
                break
            ring += 1
        if not inside or ring > _RINGS:
            squares[i] = np.inf
            for k in range(len(points)):
                _insert(squares[i], indices[i], (points[k, 0] - x) ** 2 + (points[k, 1] - y) ** 2, order[k])
    return np.sqrt(squares), indices


@nb.njit(cache=True, inline="always")
def _insert(squares: NDArray[np.float64], indices: NDArray[np.int64], square: float, index: int) -> None:
    """Inserts a point into the nearest ones (K,) so far, if it is one of them."""
    place = len(squares)
    while place > 0 and squares[place - 1] > square:
        place -= 1
    for k in range(len(squares) - 1, place, -1):
        squares[k], indices[k] = squares[k - 1], indices[k - 1]
    if place < len(squares):
        squares[place], indices[place] = square, index
