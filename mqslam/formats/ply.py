"""Writes the point map of a run as PLY, and reads it back."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core.point_map import PointMap
from mqslam.errors import untrusted
from mqslam.execution.files import write_aside

_VERTEX = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("time", "<f8"), ("psi", "<f4")]
_CLOCK: Final = re.compile(r"mqslam clock: times are seconds since (\d{1,19}) us, a scan takes (\d{1,19}) us")
_OF_LIDAR: Final = "comment mqslam sensor: lidar"  # maps of radars do not state their sensor, nor do older maps
_HEADER_BYTES: Final = 1 << 16  # size limit: comments are looked for in this many bytes at the beginning


@dataclass(frozen=True, slots=True)
class MapClock:
    """The relation between the times of a run's point map and the stamps of its trajectory, and the kind of its sensor.

    Args:
        start_us: stamp from which times are counted [us]: the recording's start, or 0 if the times are stamps themselves.
        scan_us: usual duration of a scan [us].
        is_of_lidar: whether a lidar has seen the points, and not a radar.
    """

    start_us: int
    scan_us: int
    is_of_lidar: bool = False


def write_ply(path: Path, pointmap: PointMap, clock: MapClock | None = None) -> None:
    """Writes a binary little-endian PLY with the vertex properties x, y, z [m], intensity, time [s] and psi; z is 0.

    Open3D's tensor reader (`open3d.t.io.read_point_cloud`) keeps all properties; time is a double, the others are floats.

    Args:
        path: the file.
        pointmap: the points, with times since the recording's start.
        clock: relation of the times to the stamps of the run's trajectory. The times are then written in the clock of these
            stamps, and a comment in the file says so; another comment marks the map of a lidar. None writes the times as
            they are, and no comment.

    Raises:
        OutputError: the file cannot be written.
    """
    start_s = 0.0 if clock is None else 1e-6 * clock.start_us
    with write_aside(path) as aside, aside.open("wb") as file:
        file.write(_format_header(len(pointmap), clock).encode("ascii"))
        for block in pointmap.blocks():
            vertices = np.zeros(len(block), dtype=_VERTEX)
            vertices["x"], vertices["y"] = block.points.T
            vertices["intensity"] = block.intensities
            vertices["time"] = block.times + start_s
            vertices["psi"] = block.psi
            file.write(vertices.data)


def _format_header(count: int, clock: MapClock | None) -> str:
    """Returns the header of a PLY with `count` points, with comments on the clock and the sensor if the clock is given."""
    lines = ["ply", "format binary_little_endian 1.0"]
    if clock is not None:
        lines.append(f"comment mqslam clock: times are seconds since 0 us, a scan takes {clock.scan_us} us")
        lines += [_OF_LIDAR] if clock.is_of_lidar else []
    lines.append(f"element vertex {count}")
    lines += [f"property {'double' if kind == '<f8' else 'float'} {name}" for name, kind in _VERTEX]
    return "\n".join([*lines, "end_header", ""])


def read_clock(path: Path) -> MapClock | None:
    """Returns the clock that a PLY states in a comment, or None if it states none.

    Raises:
        OSError: the file cannot be read.
    """
    with untrusted.check_file(path).open("rb") as file:
        header, end, _ = file.read(_HEADER_BYTES).partition(b"end_header")
    lines = [line.strip() for line in header.decode("latin-1").splitlines()] if end else []
    for line in lines:
        match = _CLOCK.fullmatch(line.removeprefix("comment ").strip())
        if match is not None and int(match[2]) > 0:
            return MapClock(int(match[1]), int(match[2]), _OF_LIDAR in lines)
    return None


@untrusted.reads_file
def read_ply(path: Path, names: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Reads the named properties of the N vertices of a run's PLY, and returns each (N,) by its name.

    Raises:
        DataError: the file cannot be read, or lacks one of the properties.
    """
    from plyfile import PlyData

    vertices = PlyData.read(str(untrusted.check_file(path)))["vertex"]
    return {name: np.asarray(vertices[name], dtype=np.float64) for name in names}
