"""Computes the covariance of the pose of a scan that was matched to a map of points, from the residuals of the match."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.core import se2
from mqslam.psi.neighbours import mark_near, sort_into_cells

# Number of nearest map points that show the direction of the surface at a point.
_SURFACE_POINTS = 10
# Least variance of a surface's points across the surface, as a share of their variance along it.
_FLATTEST = 0.01
_LEAST_M = 1e-3  # least residual and least lever arm [m], so that no matrix is singular: below anything that is measured


class Surface:
    """The points of a map, with searches for the nearest points and for the surface that runs through these points.

    Args:
        points: (M, 2) points in the map's frame [m].
        cell_m: side of the cells in which points are searched [m].
    """

    def __init__(self, points: NDArray[np.float64], cell_m: float) -> None:
        self._points = points
        self._grid = sort_into_cells(points, cell_m)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._points, balanced_tree=False, compact_nodes=False)  # builds three times as fast

    def count_matched(self, scan: NDArray[np.float64], pose: se2.Array, reach: float) -> int:
        """Returns how many points (N, 2) [m] of a scan at a pose (3,) have a point of the map within `reach` [m]."""
        return int(np.count_nonzero(mark_near(self._grid, se2.transform(pose, scan), reach)))

    def find_nearest(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Returns distances (N, K) [m] and indices (N, K) of the map points nearest to points (N, 2) [m], the nearest first.

        K is `_SURFACE_POINTS`, or the number of map points if there are fewer.
        """
        distances, indices = self._tree.query(points, range(1, min(_SURFACE_POINTS, len(self._points)) + 1))
        return distances, indices

    def find_directions(self, nearest: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Finds the flatness and the direction of the surface that runs through neighbouring map points.

        Args:
            nearest: (N, K) indices of the neighbouring map points at each of N places.

        Returns:
            flatness: (N,) variance of the map points across the surface divided by the variance along it, at least
                `_FLATTEST`.
            axes: (N, 2, 2) matrices whose columns are the unit vectors across and along the surface, in the map's frame.
        """
        around = self._points[nearest]
        around = around - around.mean(axis=1, keepdims=True)
        variances, axes = np.linalg.eigh(np.swapaxes(around, 1, 2) @ around)
        return np.maximum(variances[:, 0] / np.maximum(variances[:, 1], 1e-12), _FLATTEST), axes

    def compute_covariance(
        self, scan: NDArray[np.float64], pose: se2.Array, reach: float, kernel: float
    ) -> NDArray[np.float64]:
        """Returns the covariance s^2 H^-1 (3, 3) [m, m, rad] of a scan's pose in its own frame, after point-to-point ICP.

        H is the Gauss-Newton Hessian of the residuals over x, y, yaw under Geman-McClure weights, and s^2 is the weighted
        mean square of the residuals. When a wall is moved along itself, its points find neighbours as near as before.
        Residuals along a surface are therefore weighted by the flatness of the surface (see `find_directions`), which is
        close to 0 for a flat wall; otherwise the covariance would be small along a corridor.

        Args:
            scan: (N, 2) points of the scan in the sensor's frame [m].
            pose: (3,) pose of the sensor in the map's frame [m, m, rad].
            reach: longest distance between corresponding points [m]; at least one pair must be within it.
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
