"""Neighbour candidates: a cell grid over reference points, and lists that stay valid while points move a little.

Between nearby motions the candidates hardly change. A list is made with a larger radius than the score asks for (the
skin of a Verlet list), and it serves until points have moved so far that a neighbour could be missing from it.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray


class CellGrid(NamedTuple):
    """Reference points, sorted by square cells.

    Args:
        points: (M, 2) m, in the order of their cells.
        order: (M,) index of each sorted point among the points as they were given.
        keys: (M,) cell of each sorted point, increasing.
        corner: (2,) m, lower left corner of the first cell.
        cell: side of a cell [m].
        rows: number of cells in y.
    """

    points: NDArray[np.float64]
    order: NDArray[np.int64]
    keys: NDArray[np.int64]
    corner: NDArray[np.float64]
    cell: float
    rows: int


def sort_into_cells(points: NDArray[np.float64], cell: float) -> CellGrid:
    """Sorts points (M, 2) m into square cells of side `cell` [m]."""
    if len(points) == 0:
        return CellGrid(points, np.empty(0, np.int64), np.empty(0, np.int64), np.zeros(2), cell, 1)
    corner = points.min(axis=0) - cell
    index = np.floor((points - corner) / cell).astype(np.int64)
    rows = int(index[:, 1].max()) + 2
    keys = index[:, 0] * rows + index[:, 1]
    order = np.argsort(keys, kind="stable")
    return CellGrid(np.ascontiguousarray(points[order]), order, keys[order], corner, cell, rows)


class CandidateLists(NamedTuple):
    """For every query point the reference points that are near it.

    Args:
        offsets: (N + 1,) where the list of each query begins among the indices; the last one is where they end.
        indices: (K,) indices of reference points.
        radius: how near they are [m].
    """

    offsets: NDArray[np.int64]
    indices: NDArray[np.int64]
    radius: float


def find_candidates(grid: CellGrid, queries: NDArray[np.float64], radius: float) -> CandidateLists:
    """Finds the reference points near each query; a query that is itself a reference point is listed too.

    Args:
        grid: the reference points.
        queries: (N, 2) m.
        radius: how near the reference points are [m].
    """
    offsets = np.zeros(len(queries) + 1, np.int64)
    _visit(grid, queries, radius, offsets, np.empty(0, np.int64), False)
    indices = np.empty(offsets[-1], np.int64)
    _visit(grid, queries, radius, offsets, indices, True)
    return CandidateLists(offsets, indices, radius)


@nb.njit(cache=True, inline="always")
def _find_first(keys: NDArray[np.int64], key: int) -> int:
    """Returns the index of the first of the increasing keys that is not below `key`."""
    low, high = 0, len(keys)
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low


@nb.njit(cache=True, nogil=True)
def _visit(
    grid: CellGrid,
    queries: NDArray[np.float64],
    radius: float,
    offsets: NDArray[np.int64],
    indices: NDArray[np.int64],
    fill: bool,
) -> None:
    """Counts the neighbours of every query into the offsets, or fills in their indices once the offsets are known."""
    points, order, keys, corner, cell, rows = grid
    if len(keys) == 0:
        return
    for i in range(len(queries)):
        x, y = queries[i, 0], queries[i, 1]
        low = max(0, int(np.floor((y - radius - corner[1]) / cell)))
        high = min(rows - 1, int(np.floor((y + radius - corner[1]) / cell)))
        left = max(0, int(np.floor((x - radius - corner[0]) / cell)))
        right = int(np.floor((x + radius - corner[0]) / cell))
        slot = offsets[i]
        for column in range(left, right + 1 if low <= high else left):
            if column * rows > keys[-1]:
                break
            for k in range(_find_first(keys, column * rows + low), len(keys)):
                if keys[k] > column * rows + high:
                    break
                dx, dy = points[k, 0] - x, points[k, 1] - y
                if dx * dx + dy * dy < radius * radius:
                    if fill:
                        indices[slot] = order[k]
                    slot += 1
        if not fill:
            offsets[i + 1] = slot


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
            moved = _largest_move(queries, self._queries)
            if grid is None:
                moved += moved if queries is references else _largest_move(references, self._references)
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
def _largest_move(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Returns the largest distance between points (N, 2) m of the same index [m]."""
    largest = 0.0
    for i in range(len(a)):
        dx, dy = a[i, 0] - b[i, 0], a[i, 1] - b[i, 1]
        largest = max(largest, dx * dx + dy * dy)
    return float(np.sqrt(largest))
