"""Writes an occupancy grid as a GeoTIFF (OGC 19-008r4), which GIS programs show on other maps, and a trajectory as GeoJSON.

The GeoTIFF's coordinates are a transverse Mercator projection about the origin of the map's tangent plane. Within some
kilometres the projection and the plane differ by less than a millimetre. An affine transformation in the file leads from
pixels to these coordinates.
"""

from __future__ import annotations

import contextlib
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

import numpy as np
from PIL import Image, TiffImagePlugin

from mqslam.core.point_map import OccupancyGrid
from mqslam.core.sensors import Georeference
from mqslam.core.trajectory import Trajectory
from mqslam.execution.files import write_aside, write_json

_OCCUPIED: Final = 255
_TRANSFORMATION, _KEYS, _DOUBLES, _NAMES, _NOTHING = 34264, 34735, 34736, 34737, 42113  # numbers of TIFF tags
_USER_DEFINED: Final = 32767
_METRE, _DEGREE, _WGS_84 = 9001, 9102, 4326  # codes of EPSG
_PROJECTION_NAME: Final = "Transverse Mercator about the map's tangent plane|"
_DIGITS = 8  # decimals of a degree: the last one is a millimetre
_BEGINNING = datetime(1970, 1, 1, tzinfo=UTC)


def write_geotiff(path: Path, grid: OccupancyGrid, place: Georeference) -> None:
    """Writes a grid as a GeoTIFF: pixels are 255 where a cell is occupied, and 0, which means no data, everywhere else.

    Args:
        path: the file.
        grid: the map.
        place: where the map lies on the Earth.

    Raises:
        OutputError: the file cannot be written.
    """
    image = Image.fromarray(np.where(grid.occupied[::-1], np.uint8(_OCCUPIED), np.uint8(0)))
    with write_aside(path) as aside:
        image.save(aside, format="TIFF", compression="tiff_deflate", tiffinfo=_make_tags(grid, place))


def _make_tags(grid: OccupancyGrid, place: Georeference) -> TiffImagePlugin.ImageFileDirectory_v2:
    """Returns the TIFF tags that georeference the pixels; the first pixel is the cell with the lowest x and highest y."""
    c, s, step = np.cos(place.pose[2]), np.sin(place.pose[2]), grid.resolution
    left, top = grid.origin[0], grid.origin[1] + step * grid.occupied.shape[0]
    x, y = place.pose[0] + c * left - s * top, place.pose[1] + s * left + c * top
    by_column_and_row = [c * step, s * step, 0.0, x, s * step, -c * step, 0.0, y, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    doubles = (place.plane.latitude, place.plane.longitude, 0.0, 0.0, 1.0)
    keys = [
        (1024, 0, 1, 1),  # a projected system
        (1025, 0, 1, 1),  # a pixel is an area
        (2048, 0, 1, _WGS_84),
        (2054, 0, 1, _DEGREE),
        (3072, 0, 1, _USER_DEFINED),
        (3073, _NAMES, len(_PROJECTION_NAME), 0),
        (3074, 0, 1, _USER_DEFINED),
        (3075, 0, 1, 1),  # transverse Mercator
        (3076, 0, 1, _METRE),
        (3080, _DOUBLES, 1, 1),  # natural origin: longitude
        (3081, _DOUBLES, 1, 0),  # natural origin: latitude
        (3082, _DOUBLES, 1, 2),  # false easting
        (3083, _DOUBLES, 1, 3),  # false northing
        (3092, _DOUBLES, 1, 4),  # scale at the natural origin
    ]
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    for tag, kind, value in (
        (_TRANSFORMATION, 12, tuple(map(float, by_column_and_row))),
        (_KEYS, 3, (1, 1, 0, len(keys), *(number for key in keys for number in key))),
        (_DOUBLES, 12, doubles),
        (_NAMES, 2, _PROJECTION_NAME),
        (_NOTHING, 2, "0"),
    ):
        tags.tagtype[tag] = kind
        tags[tag] = value
    return tags


def write_geojson(path: Path, trajectory: Trajectory, place: Georeference) -> None:
    """Writes a trajectory as a GeoJSON line; it states the time of each point unless one is after the year 9999.

    Args:
        path: the file.
        trajectory: the trajectory, with poses in the map's frame.
        place: where the map lies on the Earth.

    Raises:
        OutputError: the file cannot be written.
    """
    degrees = place.locate(trajectory.poses[:, :2]).round(_DIGITS).tolist()
    properties: dict[str, Any] = {"name": "trajectory"}
    with contextlib.suppress(OverflowError):  # ISO 8601 writes years in four digits
        times = [(_BEGINNING + timedelta(microseconds=stamp)).isoformat() for stamp in trajectory.stamps_us.tolist()]
        properties["coordTimes"] = times
    line = {"type": "LineString", "coordinates": [[longitude, latitude] for latitude, longitude in degrees]}
    feature = {"type": "Feature", "geometry": line, "properties": properties}
    write_json(path, {"type": "FeatureCollection", "features": [feature]})
