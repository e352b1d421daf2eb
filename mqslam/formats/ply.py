"""A run's point map as PLY."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core.point_map import PointMap
from mqslam.errors import DataError
from mqslam.execution.files import write_aside

_VERTEX = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("time", "<f8"), ("psi", "<f4")]


def write_ply(path: Path, pointmap: PointMap) -> None:
    """Writes a binary little-endian PLY with the vertex properties x, y, z, intensity, time and psi; z is 0.

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
    with write_aside(path) as aside:
        PlyData([PlyElement.describe(vertices, "vertex")], byte_order="<").write(str(aside))


def read_ply(path: Path, names: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Reads vertex properties (N,) of a run's PLY by name.

    Raises:
        DataError: the file cannot be read, or lacks one of them.
    """
    from plyfile import PlyData, PlyParseError

    try:
        vertices = PlyData.read(str(path))["vertex"]
        return {name: np.asarray(vertices[name], dtype=np.float64) for name in names}
    except (OSError, ValueError, KeyError, PlyParseError) as error:
        problem = f"is not a readable PLY with {', '.join(names)} ({error})"
        raise DataError(path, problem, "give the folder of a finished run") from error
