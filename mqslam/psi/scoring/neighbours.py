"""Neighbour candidates: a cell grid over reference points, and lists that stay valid while points move a little.

Between nearby motions the candidates hardly change. A list is made with a larger radius than the score asks for (the
skin of a Verlet list), and it serves until points have moved so far that a neighbour could be missing from it.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

_ROOM = 8  # candidates per query that room is made for at first: a matter of speed only
_DENSE = 2**17  # cells of a grid up to which the first points of all cells are listed: a matter of speed only
_LAST = 2**22  # column and row of all points that lie farther out: a matter of memory only


class CellGrid(NamedTuple):
    """Reference points, sorted by square cells: column by column, and by row within a column.

    Args:
        points: (M, 2) m, in the order of their cells.
        order: (M,) index of each sorted point among the points as they were given.
        rows: (M,) row of each sorted point.
        begins: (columns + 1,) where each column begins among the sorted points; the last one is where they end.
        corner: (2,) m, lower left corner of the first cell.
        cell: side of a cell [m].
    """

    points: NDArray[np.float64]
    order: NDArray[np.int64]
    rows: NDArray[np.int64]
    begins: NDArray[np.int64]
    corner: NDArray[np.float64]
    cell: float


def sort_into_cells(points: NDArray[np.float64], cell: float, corner: NDArray[np.float64] | None = None) -> CellGrid:
    """Sorts points into square cells; those of one cell keep their order.

    Args:
        points: (M, 2) m.
        cell: side of a cell [m].
        corner: (2,) m, lower left corner of the first cell, left of and below all points; None finds it.
    """
    if len(points) == 0:
        return CellGrid(points, np.empty(0, np.int64), np.empty(0, np.int64), np.zeros(1, np.int64), np.zeros(2), cell)
    corner = find_corner(points) - cell if corner is None else corner
    found, order, rows, begins = sort_points(points, cell, corner)
    return CellGrid(found, order, rows, begins, corner, cell)


@nb.njit(cache=True, nogil=True)
def find_corner(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the smallest x and y (2,) of points (M, 2), of which there is one at least."""
    left, low = points[0, 0], points[0, 1]
    for i in range(1, len(points)):
        left, low = min(left, points[i, 0]), min(low, points[i, 1])
    return np.array([left, low])


@nb.njit(cache=True, nogil=True, error_model="numpy")
def sort_points(
    points: NDArray[np.float64], cell: float, corner: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Sorts points (M, 2) m of which there is one at least; see `sort_into_cells`.

    Returns:
        The fields of a `CellGrid` but the last two: the points are counted into rows first, and then into columns.
    """
    n = len(points)
    column, row = np.empty(n, np.int64), np.empty(n, np.int64)
    for i in range(n):
        column[i], row[i] = find_cell(points[i, 0] - corner[0], cell), find_cell(points[i, 1] - corner[1], cell)
    by_row = _order_by(row, np.arange(n))[0]
    order, begins = _order_by(column, by_row)
    found, rows = np.empty((n, 2)), np.empty(n, np.int64)
    for k in range(n):
        found[k, 0], found[k, 1] = points[order[k], 0], points[order[k], 1]
        rows[k] = row[order[k]]
    return found, order, rows, begins


@nb.njit(cache=True, inline="always")
def find_cell(distance: float, cell: float) -> int:
    """Returns the column or row that lies a distance [m] from the grid's corner, or the nearest one that there is."""
    return max(0, min(int(np.floor(distance / cell)), _LAST))


@nb.njit(cache=True, nogil=True)
def _order_by(keys: NDArray[np.int64], order: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Sorts an order of items by their keys, of which none is negative; equal ones keep theirs.

    Returns:
        The new order (N,), and where the items of each key begin in it (K + 1,).
    """
    begins = np.zeros(keys.max() + 2, np.int64)
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
def list_firsts(grid: CellGrid) -> NDArray[np.int32]:
    """Returns for every column and row (columns, rows + 1) the first point of the column that is not below the row.

    The result has no rows where the cells are so many that it would not pay.
    """
    rows, begins = grid.rows, grid.begins
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
    """Returns the first index from begin to end whose row, in increasing order, is not below `row`; else the end."""
    while begin < end:
        middle = (begin + end) // 2
        if rows[middle] < row:
            begin = middle + 1
        else:
            end = middle
    return begin


class CandidateLists(NamedTuple):
    """For every query point the reference points that are near it.

    Args:
        offsets: (N + 1,) where the list of each query begins among the indices; the last one is where they end.
        indices: (K,) indices of reference points.
        radius: how near they are [m].
    """

    offsets: NDArray[np.int64]
    indices: NDArray[np.int64] | NDArray[np.int32]
    radius: float


def find_candidates(grid: CellGrid, queries: NDArray[np.float64], radius: float) -> CandidateLists:
    """Finds the reference points near each query; a query that is itself a reference point is listed too.

    Args:
        grid: the reference points.
        queries: (N, 2) m.
        radius: how near the reference points are [m].
    """
    offsets, indices = list_near(grid, list_firsts(grid), queries, radius)
    return CandidateLists(offsets, grid.order[indices], radius)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def list_near(
    grid: CellGrid, firsts: NDArray[np.int32], queries: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Returns offsets and indices of `CandidateLists`, the indices being those of the sorted points of the grid.

    Every candidate is written down, and the next one overwrites one that is too far away.

    Args:
        grid: the reference points.
        firsts: of the grid, as `list_firsts` gives them.
        queries: (N, 2) m.
        radius: how near the reference points are [m].
    """
    points, _, rows, begins, corner, cell = grid
    left_m, low_m = corner[0], corner[1]
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
    return offsets, indices[:count].copy()


@nb.njit(cache=True, nogil=True)
def mark_near(grid: CellGrid, queries: NDArray[np.float64], radius: float) -> NDArray[np.bool_]:
    """Marks the queries (N,) of positions (N, 2) m that have a reference point nearer than a radius [m]."""
    points, _, _, begins, corner, cell = grid
    marked = np.zeros(len(queries), np.bool_)
    for i in range(len(queries)):
        x, y = queries[i, 0], queries[i, 1]
        low, high = find_cell(y - radius - corner[1], cell), find_cell(y + radius - corner[1], cell)
        left, right = find_cell(x - radius - corner[0], cell), find_cell(x + radius - corner[0], cell)
        for column in range(left, min(right, len(begins) - 2) + 1):
            k = find_first(grid.rows, begins[column], begins[column + 1], low)
            while not marked[i] and k < begins[column + 1] and grid.rows[k] <= high:
                marked[i] = (points[k, 0] - x) ** 2 + (points[k, 1] - y) ** 2 < radius * radius
                k += 1
    return marked


class NeighbourCache:
    """Candidate lists that serve several evaluations at nearby motions.

    A list of radius R that was made at positions q0 (queries) and m0 (references) serves positions q, m and a selection
    radius s as long as s + max|q - q0| + max|m - m0| <= R. It is renewed when it is wastefully large.

    Args:
        skin: by how much lists are made larger than the selection radius [m]; it changes the speed, not the neighbours.
        waste: a list whose radius is larger than this many times the radius of a new one is renewed; for speed as well.
    """

    def __init__(self, skin: float = 0.3, waste: float = 2.0) -> None:
        self.skin = skin
        self.waste = waste
        self._lists: CandidateLists | None = None
        self._queries = np.empty((0, 2))
        self._references = np.empty((0, 2))
        self._grid: CellGrid | None = None
        self.builds = 0

    def lists(
        self, queries: NDArray[np.float64], references: NDArray[np.float64], s: float, grid: CellGrid | None = None
    ) -> CandidateLists:
        """Returns lists that hold every reference within s [m] of each query, and some beyond.

        Args:
            queries: (N, 2) m.
            references: (M, 2) m.
            s: selection radius [m].
            grid: the references, sorted into cells, where they do not move between calls.
        """
        if self._lists is not None and len(queries) == len(self._queries) and len(references) == len(self._references):
            moved = measure_largest_move(queries, self._queries)
            if grid is None:
                moved += moved if queries is references else measure_largest_move(references, self._references)
            need = s + moved
            same = grid is None or grid is self._grid
            if same and need <= self._lists.radius <= self.waste * (s + self.skin):
                return self._lists
        radius = s + self.skin
        self._grid = grid
        self._lists = find_candidates(grid or sort_into_cells(references, radius), queries, radius)
        self._queries, self._references = queries.copy(), references.copy()
        self.builds += 1
        return self._lists


@nb.njit(cache=True, nogil=True)
def measure_largest_move(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Returns the largest distance between points (N, 2) m of the same index [m]."""
    largest = 0.0
    for i in range(len(a)):
        dx, dy = a[i, 0] - b[i, 0], a[i, 1] - b[i, 1]
        largest = max(largest, dx * dx + dy * dy)
    return float(np.sqrt(largest))
