"""Reads a finished run or the keyframes of a map for the viewers, colours the points, and checks for a screen."""

from __future__ import annotations

import ctypes
import os
import sys
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

# colours that people with any colour vision can distinguish
GROUND = (0x10, 0x14, 0x1A)
TRAJECTORY = (0xFF, 0xFF, 0xFF)
LOOPS = (0xF2, 0x4B, 0xC4)
_DIM = 0.35  # share of the colour map at its dark end that is not used, since it would not stand out from the ground


@dataclass(frozen=True, slots=True)
class RunScene:
    """A map of K scans, the trajectory along which it was made, and its loop closures.

    Args:
        name: name of the folder that the map was read from.
        points: (N, 2) x, y [m], world frame, ordered by time.
        values: values (N,) of the points by name: "psi" (absent for keyframes), "intensity" 0..255, and "time" [s] since the
            start of the (first) recording.
        trajectory: pose of the sensor at the start of every scan, world frame.
        loops: (L, 2) numbers of the two scans that each loop closure connects.
        starts: (S,) numbers of the scans with which a further recording begins; empty for a single recording.
    """

    name: str
    points: NDArray[np.float64]
    values: dict[str, NDArray[np.float64]]
    trajectory: Trajectory
    loops: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    starts: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @property
    def start_times(self) -> NDArray[np.float64]:
        """Start (K,) of every scan [s] since the recording's start."""
        return self.trajectory.seconds(int(self.trajectory.stamps_us[0]))


def read_scene(run: Path) -> RunScene:
    """Reads the map, trajectory and loop closures of a run from its map.ply, trajectory.tum and graph.g2o.

    Where there is no map.ply, the scene consists of the keyframes in the folder, without loop closures.

    Args:
        run: folder of a run's results, or a folder that holds keyframes.

    Raises:
        DataError: the folder holds neither a map.ply nor keyframes, or a file is missing or damaged.
    """
    name = run.resolve().name
    if not (run / "map.ply").is_file():
        if find_keyframes(run) is None:
            raise DataError(run, "holds no map.ply and no keyframes", "give the folder of a finished run")
        return _show_keyframes(name, read_keyframes(run).keyframes)
    columns = read_ply(run / "map.ply", ("x", "y", "psi", "intensity", "time"))
    trajectory = read_tum(run / "trajectory.tum")
    clock = read_clock(run / "map.ply")
    if clock is not None and clock.start_us == 0:
        columns["time"] -= 1e-6 * trajectory.stamps_us[0]
    points = np.column_stack([columns.pop("x"), columns.pop("y")])
    return RunScene(name, points, columns, trajectory, _read_loops(run / "graph.g2o", len(trajectory)))


def _show_keyframes(name: str, keyframes: Keyframes) -> RunScene:
    """Returns the keyframes of a map as a scene; the times of each recording continue after the end of the previous one."""
    points = render_keyframes(keyframes)
    return RunScene(
        name=name,
        points=points.points,
        values={"intensity": points.intensities, "time": points.times},
        trajectory=Trajectory(np.round(points.starts * 1e6).astype(np.int64), keyframes.poses),
        starts=np.flatnonzero(np.diff(keyframes.origins)) + 1,
    )


def _read_loops(path: Path, scans: int) -> NDArray[np.int64]:
    """Reads the two scans (L, 2) of each loop closure in a graph: an edge between scans that do not follow each other.

    The first `scans` poses of the graph belong to the scans; `DataError` is raised if the graph does not fit them.
    """
    edges, poses = read_edges(path)
    if poses < scans or any(not 0 <= k < poses for edge in edges for k in edge):
        raise DataError(path, f"does not fit the {scans} poses of trajectory.tum", "run the recording again")
    loops = [edge for edge in edges if max(edge) < scans and abs(edge[1] - edge[0]) > 1]
    return np.array(loops, dtype=np.int64).reshape(-1, 2)


def lift(points: NDArray[np.float64], z: float = 0.0) -> NDArray[np.float64]:
    """Returns points (N, 2) x, y [m] as points (N, 3) x, y, z [m] at the height `z` [m]."""
    return np.column_stack([points, np.full(len(points), z)])


def colour_between(values: NDArray[np.float64], low: float, high: float) -> NDArray[np.uint8]:
    """Returns colours (N, 3) red, green, blue, 0..255, of values (N,): dim up to the value `low`, bright from `high` on."""
    from matplotlib import colormaps

    share = np.clip((values - low) / max(high - low, 1e-12), 0.0, 1.0)
    return np.asarray(colormaps["viridis"](_DIM + (1.0 - _DIM) * share, bytes=True)[:, :3])


def colour_over_span(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Returns colours (N, 3) of values (N,) as `colour_between` does: dim up to their 1 % quantile, bright from 99 % on."""
    low, high = np.quantile(values, [0.01, 0.99]) if len(values) else (0.0, 1.0)
    return colour_between(values, float(low), float(high))


def has_display() -> bool:
    """Returns whether there is a screen to open a window on; systems other than Linux are assumed to have a screen."""
    if sys.platform != "linux" or "WAYLAND_DISPLAY" in os.environ:
        return True
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError:
        return False
    x11.XOpenDisplay.restype = ctypes.c_void_p
    x11.XCloseDisplay.argtypes = [ctypes.c_void_p]
    display = x11.XOpenDisplay(None)  # the variable DISPLAY may name a display that is gone
    if display is None:
        return False
    x11.XCloseDisplay(display)
    return True
