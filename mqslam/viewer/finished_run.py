"""A finished run, or the keyframes of a map, as the viewers show them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core.keyframes import Keyframes
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.graphs.g2o import read_edges
from mqslam.formats.maps.keyframe_folder import find_keyframes, read_keyframes
from mqslam.formats.ply import read_clock, read_ply
from mqslam.formats.tum import read_tum
from mqslam.mapping.keyframing import render_keyframes

_REMEDY = "give the folder of a finished run"


@dataclass(frozen=True, slots=True)
class RunScene:
    """A map, the trajectory through it and its loop closures.

    Args:
        name: name of the run.
        points: (N, 2) [m], world frame, ordered by time.
        values: (N,) each, by name: psi, intensity 0..255, time [s] since the recording's start; keyframes have no psi.
        trajectory: pose of the sensor at the start of every scan, world frame.
        loops: (L, 2) numbers of the two scans of every loop closure.
        starts: (S,) numbers of the scans, besides the first one, with which another recording begins.
    """

    name: str
    points: NDArray[np.float64]
    values: dict[str, NDArray[np.float64]]
    trajectory: Trajectory
    loops: NDArray[np.int64]
    starts: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @property
    def start_times(self) -> NDArray[np.float64]:
        """(K,) start of every scan [s] since the recording's start."""
        return self.trajectory.seconds(int(self.trajectory.stamps_us[0]))


def read_scene(run: Path) -> RunScene:
    """Reads the map, trajectory and loop closures of a run from its map.ply, trajectory.tum and graph.g2o.

    Where there is no map.ply, the scene shows the keyframes in the folder.

    Args:
        run: folder of the run's results, or one that holds keyframes.

    Raises:
        DataError: the folder holds neither, or a file in it is damaged.
    """
    if not (run / "map.ply").is_file():
        if find_keyframes(run) is not None:
            return _show_keyframes(run.resolve().name, read_keyframes(run).keyframes)
        raise DataError(run, "holds no map.ply and no keyframes", _REMEDY)
    columns = read_ply(run / "map.ply", ("x", "y", "psi", "intensity", "time"))
    trajectory = read_tum(run / "trajectory.tum")
    clock = read_clock(run / "map.ply")
    if clock is not None and clock.start_us == 0:
        columns["time"] -= 1e-6 * trajectory.stamps_us[0]
    return RunScene(
        name=run.resolve().name,
        points=np.column_stack([columns.pop("x"), columns.pop("y")]),
        values=columns,
        trajectory=trajectory,
        loops=_read_loops(run / "graph.g2o", len(trajectory)),
    )


def _show_keyframes(name: str, keyframes: Keyframes) -> RunScene:
    """Returns keyframes as a scene; the time of each recording goes on where that of the one before has ended."""
    points = render_keyframes(keyframes)
    starts = np.flatnonzero(np.diff(keyframes.origins)) + 1
    return RunScene(
        name=name,
        points=points.points,
        values={"intensity": points.intensities, "time": points.times},
        trajectory=Trajectory(np.round(points.starts * 1e6).astype(np.int64), keyframes.poses),
        loops=np.empty((0, 2), dtype=np.int64),
        starts=starts,
    )


def _read_loops(path: Path, scans: int) -> NDArray[np.int64]:
    """Reads the edges (L, 2) of a pose graph that join scans which do not follow each other."""
    edges, poses = read_edges(path)
    if poses < scans or any(not 0 <= k < poses for edge in edges for k in edge):
        raise DataError(path, f"does not fit the {scans} poses of trajectory.tum", "run the recording anew")
    loops = [edge for edge in edges if max(edge) < scans and abs(edge[1] - edge[0]) > 1]
    return np.array(loops, dtype=np.int64).reshape(-1, 2)
