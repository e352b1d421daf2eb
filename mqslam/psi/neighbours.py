"""Sorts points into a grid of cells, and lists near points; the lists stay valid over small motions.

A list holds points up to a radius that is larger than the reach of the score (the difference is the skin of a Verlet list).
It stays valid until points have moved so far that a neighbour within the reach could be missing.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

_ROOM = 8  # number of neighbours per query for which memory is reserved at first; affects only speed
_DENSE = 2**17  # largest number of cells for which `CellGrid.firsts` is filled; affects only speed
_LAST = 2**22  # number of the last column and row, whose cells also hold all points farther out; affects only memory
_WASTE = 2.0  # lists are renewed if they reach more than this many times as far as new lists would; affects only speed


class CellGrid(NamedTuple):
    """Points, sorted by square cells: by column of the grid (along x), and by row of the grid (along y) within a column.

    Args:
        points: (M, 2) m, in the order of their cells.
        order: (M,) index of each sorted point among the points as they were given.
        rows: (M,) number of the grid row in which each sorted point lies.
        begins: (columns + 1,) index of the first sorted point of each column; the last entry is M.
        firsts: (columns, number of rows + 1) entry [c, r] is the index of the first sorted point of column c whose row is
            r or higher; `begins[c + 1]` if there is none. The table is empty if it would cost more time than it saves.
        corner: (2,) x, y [m] of the lower left corner of the first cell.
        cell: side of a cell [m].
    """

    points: NDArray[np.float64]
    order: NDArray[np.int64]
    rows: NDArray[np.int64]
    begins: NDArray[np.int64]
    firsts: NDArray[np.int32]
    corner: NDArray[np.float64]
    cell: float


class NearbyLists(NamedTuple):
    """Lists of the points of a grid that are near each query.

    Args:
        offsets: (N + 1,) position in `indices` at which the list of each query begins; the last entry is K.
        indices: (K,) indices of points, among the sorted points of the grid (`list_near`) or among the points as they
            were given to the grid (`find_candidates`).
        queries: (N, 2) m, positions of the queries when the lists were made.
        radius: distance from a query within which points are listed [m].
    """

    offsets: NDArray[np.int64]
    indices: NDArray[np.int64] | NDArray[np.int32]
    queries: NDArray[np.float64]
    radius: float


@nb.njit(cache=True, nogil=True)
def find_corner(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the smallest x and the smallest y (2,) [m] of one or more points (M, 2) [m]."""
    left, low = points[0, 0], points[0, 1]
    for i in range(1, len(points)):
        left, low = min(left, points[i, 0]), min(low, points[i, 1])
    return np.array([left, low])


@nb.njit(cache=True, nogil=True, error_model="numpy")
def sort_into_cells(points: NDArray[np.float64], cell: float, corner: NDArray[np.float64] | None = None) -> CellGrid:
    """Sorts points into square cells; points of one cell keep their order.

    Args:
        points: (M, 2) m.
        cell: side of a cell [m].
        corner: (2,) x, y [m] of the lower left corner of the first cell, below and left of all points; None takes the
            smallest x and the smallest y of the points, each minus a cell.
    """
    n = len(points)
    lowest = np.zeros(2)
    if corner is not None:
        lowest[:] = corner
    elif n > 0:
        lowest[:] = find_corner(points) - cell
    column, row = np.empty(n, np.int64), np.empty(n, np.int64)
    for i in range(n):
        column[i], row[i] = find_cell(points[i, 0] - lowest[0], cell), find_cell(points[i, 1] - lowest[1], cell)
    order, begins = _order_by(column, _order_by(row, np.arange(n))[0])
    return CellGrid(points[order], order, row[order], begins, _list_firsts(row[order], begins), lowest, cell)


@nb.njit(cache=True, inline="always")
def find_cell(distance: float, cell: float) -> int:
    """Returns the column (or row), from 0 to `_LAST`, at a distance [m] along x (or y) from the grid's corner.

    A cell has sides of length `cell` [m].
    """
    return max(0, min(int(np.floor(distance / cell)), _LAST))


@nb.njit(cache=True, nogil=True)
def _order_by(keys: NDArray[np.int64], order: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Sorts items by their keys; items of equal keys keep their order.

    Args:
        keys: (N,) key of each item, 0 or more.
        order: (N,) indices of the items in their present order.

    Returns:
        The indices (N,) of the items in their new order, and the position (K + 1,) in this order of the first item of each
        key from 0 to K - 1, the largest key; the last entry is N.
    """
    begins = np.zeros(keys.max() + 2 if len(keys) else 1, np.int64)
    for key in keys:
        begins[key + 1] += 1
    for k in range(1, len(begins)):
        begins[k] += begins[k - 1]
    free = begins.copy()
    result = np.empty_like(order)
    for item in order:
        result[free[keys[item]]] = item
        free[keys[item]] += 1
    return result, begins


@nb.njit(cache=True, nogil=True)
def _list_firsts(rows: NDArray[np.int64], begins: NDArray[np.int64]) -> NDArray[np.int32]:
    """Returns the table `firsts` of a `CellGrid` from its `rows` and `begins`; it is empty if there are too many cells."""
    height = rows.max() + 1 if len(rows) else 0
    if (len(begins) - 1) * height > _DENSE:
        return np.empty((0, 0), np.int32)
    firsts = np.empty((len(begins) - 1, height + 1), np.int32)
    for column in range(len(begins) - 1):
        row = 0
        for k in range(begins[column], begins[column + 1]):
            while row <= rows[k] and row <= height:
                firsts[column, row] = k
                row += 1
        firsts[column, row:] = begins[column + 1]
    return firsts


@nb.njit(cache=True, inline="always")
def find_first(rows: NDArray[np.int64], begin: int, end: int, row: int) -> int:
    """Returns the first k, begin <= k < end, with rows[k] >= row; `end` if there is none. The rows must be sorted."""
    while begin < end:
        middle = (begin + end) // 2
        if rows[middle] < row:
            begin = middle + 1
        else:
            end = middle
    return begin


@nb.njit(cache=True, nogil=True, error_model="numpy")
def list_near(grid: CellGrid, queries: NDArray[np.float64], radius: float) -> NearbyLists:
    """Lists the points of a grid within a radius [m] of each query (N, 2) [m], including any point at the query itself.

    Every candidate is written to the list, and the next candidate overwrites it if it is too far away: an unpredictable
    branch would take more time.
    """
    points, rows, begins, firsts, cell = grid.points, grid.rows, grid.begins, grid.firsts, grid.cell
    left_m, low_m = grid.corner[0], grid.corner[1]
    is_dense, height = len(firsts) > 0, firsts.shape[1] - 1
    offsets = np.zeros(len(queries) + 1, np.int64)
    indices = np.empty(_ROOM * len(queries) + len(points), np.int32)
    count = 0
    for i in range(len(queries)):
        if count + len(points) > len(indices):
            indices = np.concatenate((indices, np.empty_like(indices)))
        x, y = queries[i, 0], queries[i, 1]
        low, high = find_cell(y - radius - low_m, cell), find_cell(y + radius - low_m, cell)
        first, last = find_cell(x - radius - left_m, cell), find_cell(x + radius - left_m, cell)
        lowest, highest = min(low, height), min(high + 1, height)
        for column in range(first, min(last, len(begins) - 2) + 1):
            if is_dense:
                begin, end = firsts[column, lowest], firsts[column, highest]
            else:
                begin = find_first(rows, begins[column], begins[column + 1], low)
                end = find_first(rows, begin, begins[column + 1], high + 1)
            for k in range(begin, end):
                dx, dy = points[k, 0] - x, points[k, 1] - y
                indices[count] = k
                count += dx * dx + dy * dy < radius * radius
        offsets[i + 1] = count
    return NearbyLists(offsets, indices[:count].copy(), queries, radius)


@nb.njit(cache=True, nogil=True)
def find_candidates(grid: CellGrid, queries: NDArray[np.float64], radius: float) -> NearbyLists:
    """Lists the points near each query (N, 2) [m] like `list_near`; the indices count the points in their given order."""
    near = list_near(grid, queries, radius)
    return NearbyLists(near.offsets, grid.order[near.indices], queries, radius)


@register_jitable
def find_longest(offsets: NDArray[np.int64]) -> int:
    """Returns the length of the longest list, given the offsets (N + 1,) at which lists begin and end."""
    longest = 0
    for i in range(len(offsets) - 1):
        longest = max(longest, offsets[i + 1] - offsets[i])
    return longest


@register_jitable
def do_serve(lists: NearbyLists, queries: NDArray[np.float64], reach: float, skin: float, moves: float = 1.0) -> bool:
    """Returns whether lists still hold all neighbours of moved queries (N, 2) [m], and not too many other points.

    Args:
        lists: lists that were made for the same number of queries.
        queries: present positions of the queries.
        reach: distance within which neighbours are needed [m].
        skin: radius of new lists minus the reach [m].
        moves: 2 if the listed points move like the queries, 1 if the listed points are fixed.
    """
    need = reach + moves * measure_largest_move(queries, lists.queries)
    return need <= lists.radius and lists.radius <= _WASTE * (reach + skin)


@nb.njit(cache=True, nogil=True)
def measure_largest_move(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Returns the largest distance [m] between points of the same index in two arrays (N, 2) m."""
    largest = 0.0  # a compiled loop, because `do_serve` is also called from Python
    for i in range(len(a)):
        dx, dy = a[i, 0] - b[i, 0], a[i, 1] - b[i, 1]
        largest = max(largest, dx * dx + dy * dy)
    return float(np.sqrt(largest))


def mark_near(grid: CellGrid, queries: NDArray[np.float64], radius: float) -> NDArray[np.bool_]:
    """Returns a mask (N,) of the queries (N, 2) [m] that have any point of a grid within a radius [m]."""
    return np.asarray(np.diff(list_near(grid, queries, radius).offsets) > 0)
