"""A rendered map: every return of a run placed in the world by a trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError
from mqslam.execution.files import written_whole

_VERTEX = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("time", "<f8"), ("psi", "<f4")]


@dataclass(frozen=True, slots=True)
class PointMap:
    """Returns in the world frame, each with its part of the score.

    Args:
        points: (N, 2) [m], world frame.
        times: (N,) [s] since the recording's start.
        intensities: (N,) received power, 0..255.
        psi: (N,) share of the map's score that each point carries.
        matched: (N,) bool, whether the point found a neighbour that takes part in the score.
    """

    points: NDArray[np.float64]
    times: NDArray[np.float64]
    intensities: NDArray[np.float64]
    psi: NDArray[np.float64]
    matched: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.points)

    @classmethod
    def empty(cls) -> PointMap:
        """A map without points."""
        return cls(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0), np.empty(0, dtype=np.bool_))

    def take(self, chosen: NDArray[np.int64]) -> PointMap:
        """The points of indices (M,)."""
        return PointMap(
            self.points[chosen], self.times[chosen], self.intensities[chosen], self.psi[chosen], self.matched[chosen]
        )


def thinned(points: NDArray[np.float64], most: int) -> NDArray[np.int64]:
    """Indices of at most `most` of the points (N, 2): all, or one of each cell of the finest raster that leaves so few."""
    if len(points) <= most:
        return np.arange(len(points))
    order = np.random.default_rng(0).permutation(len(points))  # of a cell any point may stay, whatever its time

    def taken(cell: float) -> NDArray[np.int64]:
        column, row = np.floor((points[order] - points.min(axis=0)) / cell).astype(np.int64).T
        _, first = np.unique(column * (int(row.max()) + 1) + row, return_index=True)
        return np.sort(order[first])

    low, high = 1e-3, float(np.ptp(points, axis=0).max()) + 1e-3
    while high > 1.05 * low:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if len(taken(middle)) > most else (low, middle)
    return taken(high)


def write_ply(path: Path, pointmap: PointMap) -> None:
    """Write a binary little-endian PLY with the vertex properties x, y, z, intensity, time and psi; z is 0.

    Open3D's tensor reader (`open3d.t.io.read_point_cloud`) keeps all of them; time is a double, the rest are floats.

    Raises:
        OutputError: the file cannot be written.
    """
    from plyfile import PlyData, PlyElement

    vertices = np.zeros(len(pointmap), dtype=_VERTEX)
    vertices["x"], vertices["y"] = pointmap.points.T
    vertices["intensity"] = pointmap.intensities
    vertices["time"] = pointmap.times
    vertices["psi"] = pointmap.psi
    with written_whole(path) as aside:
        PlyData([PlyElement.describe(vertices, "vertex")], byte_order="<").write(str(aside))


def read_ply(path: Path, names: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Vertex properties (N,) of a run's PLY by name.

    Raises:
        DataError: unreadable, or without one of them.
    """
    from plyfile import PlyData, PlyParseError

    try:
        vertices = PlyData.read(str(path))["vertex"]
        return {name: np.asarray(vertices[name], dtype=np.float64) for name in names}
    except (OSError, ValueError, KeyError, PlyParseError) as error:
        problem = f"is not a readable PLY with {', '.join(names)} ({error})"
        raise DataError(path, problem, "give the folder of a finished run") from error
