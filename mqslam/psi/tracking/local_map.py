"""The running map: the returns of the last keyframes, where they were rendered."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.psi.neighbours import CellGrid, cell_grid
from mqslam.psi.place import PointSet


class LocalMap:
    """A sliding window of keyframes, held fixed while new revolutions are matched to it.

    Args:
        size: keyframes it holds.
        cell_m: side of the cells neighbours are looked up in [m].
    """

    def __init__(self, size: int, cell_m: float = 1.0) -> None:
        self._size = size
        self._cell = cell_m
        self._keyframes: list[PointSet] = []
        self.points = _joined([])
        self.grid: CellGrid = cell_grid(self.points.points, cell_m)

    def __len__(self) -> int:
        """Keyframes held."""
        return len(self._keyframes)

    def add(self, keyframe: PointSet) -> None:
        """Append a rendered revolution; the oldest one leaves when the map is full."""
        self._keyframes = [*self._keyframes[-(self._size - 1) :], keyframe] if self._size > 1 else [keyframe]
        self.points = _joined(self._keyframes)
        self.grid = cell_grid(self.points.points, self._cell)


def _joined(keyframes: list[PointSet]) -> PointSet:
    """All points of several sets, without their jacobians: a map does not move."""

    def column(arrays: list[NDArray[np.float64]], *shape: int) -> NDArray[np.float64]:
        return np.concatenate([np.empty((0, *shape)), *arrays])

    return PointSet(
        points=column([k.points for k in keyframes], 2),
        jacobians=np.zeros((0, 2, 0)),
        covariances=column([k.covariances for k in keyframes], 3),
        times=column([k.times for k in keyframes]),
    )
