"""A finished run as the viewers show it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.graphs.g2o import read_edges
from mqslam.formats.ply import read_clock, read_ply
from mqslam.formats.tum import read_tum

_REMEDY = "give the folder of a finished run"


@dataclass(frozen=True, slots=True)
class Scene:
    """A map, the trajectory through it and its loop closures.

    Args:
        name: name of the run.
        points: (N, 2) [m], world frame, ordered by time.
        values: (N,) each, by name: psi, intensity 0..255, time [s] since the recording's start.
        trajectory: pose of the sensor at the start of every scan, world frame.
        loops: (L, 2) numbers of the two scans of every loop closure.
    """

    name: str
    points: NDArray[np.float64]
    values: dict[str, NDArray[np.float64]]
    trajectory: Trajectory
    loops: NDArray[np.int64]

    @property
    def start_times(self) -> NDArray[np.float64]:
        """(K,) start of every scan [s] since the recording's start."""
        return self.trajectory.seconds(int(self.trajectory.stamps_us[0]))


def read_scene(run: Path) -> Scene:
    """Reads the map, trajectory and loop closures of a run from its map.ply, trajectory.tum and graph.g2o.

    Args:
        run: folder of the run's results.

    Raises:
        DataError: it is not the folder of a finished run, or a file in it is damaged.
    """
    if not (run / "map.ply").is_file():
        raise DataError(run, "holds no map.ply", _REMEDY)
    columns = read_ply(run / "map.ply", ("x", "y", "psi", "intensity", "time"))
    trajectory = read_tum(run / "trajectory.tum")
    clock = read_clock(run / "map.ply")
    if clock is not None and clock.start_us == 0:
        columns["time"] -= 1e-6 * trajectory.stamps_us[0]
    return Scene(
        name=run.resolve().name,
        points=np.column_stack([columns.pop("x"), columns.pop("y")]),
        values=columns,
        trajectory=trajectory,
        loops=_read_loops(run / "graph.g2o", len(trajectory)),
    )


def _read_loops(path: Path, scans: int) -> NDArray[np.int64]:
    """Reads the edges (L, 2) of a pose graph that join scans which do not follow each other."""
    edges, poses = read_edges(path)
    if poses < scans or any(not 0 <= k < poses for edge in edges for k in edge):
        raise DataError(path, f"does not fit the {scans} poses of trajectory.tum", "run the recording anew")
    loops = [edge for edge in edges if max(edge) < scans and abs(edge[1] - edge[0]) > 1]
    return np.array(loops, dtype=np.int64).reshape(-1, 2)
