"""Covariance of a scan matched to a map of points, from the residuals of its own correspondences.

The nearest points are looked for in a grid of cells, with SciPy's `cKDTree` as the readable twin: a tree of a map that
changes with every scan takes longer to build than it takes to search.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.psi.neighbours import CellGrid, find_first, mark_near, sort_into_cells

# Number of map points that show how the surface around the nearest one runs.
_SURFACE_POINTS = 10
# Least variance of a surface's points across it, as a share of that along it.
_FLATTEST = 0.01

_RINGS = 16  # rings of cells around a query beyond which all points are looked at: a matter of speed only
_LEAST_M = 1e-3  # a length that nobody measures, so that no matrix is singular: least residual and least lever arm [m]


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
    points, order, rows, begins, corner, cell = grid.points, grid.order, grid.rows, grid.begins, grid.corner, grid.cell
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


class Surface:
    """The points of a map, searchable.

    Args:
        points: (M, 2) m, map frame.
        cell_m: side of the cells in which they are searched [m].
    """

    def __init__(self, points: NDArray[np.float64], cell_m: float) -> None:
        self._points = points
        self._grid = sort_into_cells(points, cell_m)

    def count_matched(self, scan: NDArray[np.float64], pose: se2.Array, reach: float) -> int:
        """Returns how many points (N, 2) [m] of a scan at a pose (3,) have a map point within reach [m]."""
        return int(np.count_nonzero(mark_near(self._grid, se2.transform(pose, scan), reach)))

    def find_nearest(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Returns distances (N, K) [m] and indices (N, K) of the map points that are nearest to points (N, 2) [m]."""
        distances, indices = find_nearest(self._grid, points, min(_SURFACE_POINTS, len(self._points)))
        return distances, indices

    def find_directions(self, nearest: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Finds how the surface runs through neighbouring map points.

        Args:
            nearest: (N, K) their indices.

        Returns:
            flatness: (N,) variance of the map's points across the surface over that along it, at least `_FLATTEST`.
            axes: (N, 2, 2) columns are the unit vectors across and along.
        """
        around = self._points[nearest]
        around = around - around.mean(axis=1, keepdims=True)
        variances, axes = np.linalg.eigh(np.swapaxes(around, 1, 2) @ around)
        return np.maximum(variances[:, 0] / np.maximum(variances[:, 1], 1e-12), _FLATTEST), axes

    def compute_covariance(
        self, scan: NDArray[np.float64], pose: se2.Array, reach: float, kernel: float
    ) -> NDArray[np.float64]:
        """Returns the covariance s^2 H^-1 (3, 3) of a scan's pose, matched point to point, in its own frame [m, m, rad].

        H is the Gauss-Newton Hessian of the residuals over x, y, yaw under Geman-McClure weights, s^2 their weighted mean
        square. The points of a wall that is moved along itself find others as near as before. Residuals along a surface
        therefore count only in proportion to its thickness over its length; otherwise ICP would claim to know its place
        along a corridor.

        Args:
            scan: (N, 2) m, sensor frame at the pose.
            pose: (3,) of the sensor in the map frame.
            reach: farthest correspondence [m]; there must be some.
            kernel: squared residual at which a weight is a quarter [m^2].
        """
        distances, nearest = self.find_nearest(se2.transform(pose, scan))
        near = distances[:, 0] < reach
        scan, distances, nearest = scan[near], distances[near, 0], nearest[near]
        residuals = se2.transform(se2.inverse(pose), self._points[nearest[:, 0]]) - scan
        flatness, axes = self.find_directions(nearest)
        c, s = np.cos(pose[2]), np.sin(pose[2])
        axes = np.array([[c, s], [-s, c]]) @ axes
        weights = (kernel / (kernel + distances**2)) ** 2
        counts = weights[:, None] * np.stack([np.ones(len(flatness)), flatness], axis=1)
        jacobians = np.zeros((len(scan), 2, 3))
        jacobians[:, 0, 0] = jacobians[:, 1, 1] = 1.0
        jacobians[:, 0, 2], jacobians[:, 1, 2] = -scan[:, 1], scan[:, 0]
        by_axis = np.swapaxes(axes, 1, 2) @ jacobians
        hessian = np.einsum("nai,na,naj->ij", by_axis, counts, by_axis) + _LEAST_M**2 * counts.sum() * np.eye(3)
        squares = np.einsum("nia,ni->na", axes, residuals) ** 2
        inverse = np.linalg.inv(hessian) * max((counts * squares).sum() / counts.sum(), _LEAST_M**2)
        return np.asarray(0.5 * (inverse + inverse.T))
