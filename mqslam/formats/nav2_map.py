"""An occupancy grid as the image and the settings that nav2's map_server loads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from PIL import Image

from mqslam.core.point_map import OccupancyGrid
from mqslam.execution.files import write_text, written_whole

_OCCUPIED = 0
_UNKNOWN = 205


def write_nav2_map(folder: Path, grid: OccupancyGrid) -> None:
    """Write `map.pgm` and `map.yaml` into a folder, in the format of nav2's and ROS 1's map_server.

    A cell is occupied or unknown, never free: that a radar got no return from a place does not show that the place is
    empty. Planners need `allow_unknown: true` on such a map.

    Args:
        folder: an existing folder.
        grid: the map to write.

    Raises:
        OutputError: a file cannot be written.
    """
    image = Image.fromarray(np.where(grid.occupied[::-1], np.uint8(_OCCUPIED), np.uint8(_UNKNOWN)))
    with written_whole(folder / "map.pgm") as aside:
        image.save(aside, format="PPM")  # Pillow's name for PGM too
    # map_server reads a pixel p as the occupancy (255 - p) / 255: 205 gives 0.19608, just above free_thresh.
    settings = {
        "image": "map.pgm",
        "mode": "trinary",
        "resolution": grid.resolution,
        "origin": [*grid.origin, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    write_text(folder / "map.yaml", yaml.safe_dump(settings, sort_keys=False, default_flow_style=None))
