"""Planar poses and points in the three dimensions that registration libraries expect."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2


def to_matrix(pose: se2.Array) -> NDArray[np.float64]:
    """Returns a pose (3,) as the (4, 4) matrix that libraries of three dimensions take."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[c, -s, 0.0, pose[0]], [s, c, 0.0, pose[1]], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def from_matrix(matrix: NDArray[np.float64]) -> se2.Array:
    """Returns the planar part (3,) of a (4, 4) matrix."""
    return np.array([matrix[0, 3], matrix[1, 3], np.arctan2(matrix[1, 0], matrix[0, 0])])


def lift(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns points (N, 2) [m] as (N, 3) with z = 0."""
    return np.column_stack([points, np.zeros(len(points))])
