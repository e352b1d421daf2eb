"""Writes and reads an occupancy grid as the image and the settings that nav2's map_server loads."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.point_map import OccupancyGrid
from mqslam.core.sensors import Georeference
from mqslam.core.stored import release
from mqslam.errors import untrusted
from mqslam.execution.files import write_aside, write_text
from mqslam.formats.poses import mark_places

_WIDEST_M = 1e3  # no map has wider cells [m]
_OCCUPIED = 0
_FREE = 254
_UNKNOWN = 205
"""Pixels of occupied, free and unknown cells. map_server reads a pixel p as the occupancy (255 - p) / 255. The pixel 205
gives 0.19608, just above the threshold of free cells."""
_GAP = rb"(?:\s|#[^\n]*\n)+"  # between the numbers of a PGM's header, where programs that draw may leave comments
_HEADER = re.compile(rb"P5" + _GAP + rb"(?P<columns>\d+)" + _GAP + rb"(?P<rows>\d+)" + _GAP + rb"255\s")
_ROWS = 500  # rows of the image that are in memory at a time; the result does not depend on this number
_OCCUPIED_ABOVE, _FREE_BELOW = 0.65, 0.196  # map_server's usual thresholds
_MESSAGE_OCCUPIED, _MESSAGE_FREE, _MESSAGE_UNKNOWN = 100, 0, -1  # as nav_msgs/OccupancyGrid defines them


@dataclass(frozen=True, slots=True)
class Nav2Map:
    """A map as map_server publishes it.

    Args:
        cells: (H, W) int8 occupancy, 100 occupied, 0 free, -1 unknown; row 0 at the lowest y.
        resolution: side of a cell [m].
        origin: (3,) pose x, y [m], yaw [rad] of the lower left corner of cell (0, 0) in the world frame.
    """

    cells: NDArray[np.int8]
    resolution: float
    origin: se2.Array


def write_nav2_map(folder: Path, grid: OccupancyGrid, place: Georeference | None = None) -> None:
    """Writes `map.pgm` and `map.yaml` into a folder, in the format of nav2's and ROS 1's map_server.

    A radar's map has no free cells, because a place without returns need not be empty. Planners need `allow_unknown: true`
    on such a map. A lidar's map has free cells.

    Args:
        folder: an existing folder.
        grid: the map to write.
        place: where the map lies on the Earth, for `georeference` in map.yaml; map_server ignores this entry.

    Raises:
        OutputError: a file cannot be written.
    """
    rows, columns = grid.occupied.shape
    with write_aside(folder / "map.pgm") as aside, aside.open("wb") as file:
        file.write(f"P5\n{columns} {rows}\n255\n".encode("ascii"))
        for end in range(rows, 0, -_ROWS):
            rows_here = slice(max(end - _ROWS, 0), end)
            pixels = np.where(grid.occupied[rows_here][::-1], np.uint8(_OCCUPIED), np.uint8(_UNKNOWN))
            if grid.free is not None:
                pixels[grid.free[rows_here][::-1]] = _FREE
            file.write(pixels.data)
            release(grid.occupied)
    settings: dict[str, object] = {
        "image": "map.pgm",
        "mode": "trinary",
        "resolution": grid.resolution,
        "origin": [*grid.origin, 0.0],
        "negate": 0,
        "occupied_thresh": _OCCUPIED_ABOVE,
        "free_thresh": _FREE_BELOW,
    }
    if place is not None:
        (latitude, longitude), yaw = place.locate(np.zeros((1, 2)))[0].tolist(), float(place.pose[2])
        settings["georeference"] = {"latitude": latitude, "longitude": longitude, "yaw_from_east": yaw}
    write_text(folder / "map.yaml", yaml.safe_dump(settings, sort_keys=False, default_flow_style=None))


@untrusted.reads_file
def read_nav2_map(file: Path) -> Nav2Map:
    """Reads a `map.yaml` and the image that it names as map_server would in the mode `trinary` with `negate: 0`.

    Raises:
        DataError: a file cannot be read, or the files hold no map that map_server can load.
    """
    settings = yaml.safe_load(untrusted.read_document(file, untrusted.YAML_BYTES))
    content = untrusted.check_file(file.parent / settings["image"]).read_bytes()
    header = _HEADER.match(content)
    if header is None:
        raise ValueError("its image is no binary PGM (P5) of pixels from 0 to 255")
    image = np.frombuffer(content, dtype=np.uint8, offset=header.end()).reshape(int(header["rows"]), int(header["columns"]))
    darkness = (255.0 - np.arange(256)) / 255.0
    meaning = np.full(256, _MESSAGE_UNKNOWN, dtype=np.int8)
    meaning[darkness > settings["occupied_thresh"]] = _MESSAGE_OCCUPIED
    meaning[darkness < settings["free_thresh"]] = _MESSAGE_FREE
    origin = np.array(settings["origin"], dtype=np.float64).reshape(3)
    resolution = float(settings["resolution"])
    if not (mark_places(origin) and 0.0 < resolution < _WIDEST_M):
        raise ValueError("its resolution is no length of a cell, or its origin is no pose")
    return Nav2Map(meaning[image[::-1]], resolution, origin)
