"""A trajectory on the Earth as GeoJSON (RFC 7946), which maps in browsers and GIS programs show."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

from mqslam.core.sensors import Georeference
from mqslam.core.trajectory import Trajectory
from mqslam.execution.files import write_json

_DIGITS = 8  # of a degree: a millimetre
_BEGINNING = datetime(1970, 1, 1, tzinfo=UTC)


def write_geojson(path: Path, trajectory: Trajectory, place: Georeference) -> None:
    """Writes a trajectory as a line with the time of each of its points.

    Args:
        path: the file.
        trajectory: poses in the map.
        place: where the map lies.

    Raises:
        OutputError: the file cannot be written.
    """
    degrees = place.locate(trajectory.poses[:, :2]).round(_DIGITS).tolist()
    times = [(_BEGINNING + timedelta(microseconds=stamp)).isoformat() for stamp in trajectory.stamps_us.tolist()]
    line = {"type": "LineString", "coordinates": [[longitude, latitude] for latitude, longitude in degrees]}
    feature = {"type": "Feature", "geometry": line, "properties": {"name": "trajectory", "coordTimes": times}}
    write_json(path, {"type": "FeatureCollection", "features": [feature]})
