"""What places a map on the Earth is read by GDAL and by readers of GeoJSON as it was meant."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from mqslam.core.point_map import OccupancyGrid
from mqslam.core.sensors import Georeference, TangentPlane
from mqslam.core.trajectory import Trajectory
from mqslam.formats.maps.georeferenced import write_geojson, write_geotiff
from mqslam.formats.maps.nav2_map import read_nav2_map, write_nav2_map

PLACE = Georeference(TangentPlane(48.1, 11.5), np.array([120.0, -40.0, 0.7]))


def make_grid() -> OccupancyGrid:
    occupied = np.zeros((30, 50), dtype=np.bool_)
    occupied[4, 7] = occupied[25, 40] = True
    return OccupancyGrid(occupied, 0.5, (-6.0, 3.0))


def test_gdal_finds_each_cell_where_it_lies(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    from rasterio.warp import transform

    write_geotiff(tmp_path / "map.tif", make_grid(), PLACE)
    with rasterio.open(tmp_path / "map.tif") as file:
        pixels, nothing = file.read(1), file.nodata
        found = sorted((row, column) for row, column in np.argwhere(pixels != nothing).tolist())
        places = [file.xy(row, column) for row, column in found]
        longitudes, latitudes = transform(file.crs, "EPSG:4326", *zip(*places, strict=True))
    cells = np.array([[-6.0 + 0.5 * 40.5, 3.0 + 0.5 * 25.5], [-6.0 + 0.5 * 7.5, 3.0 + 0.5 * 4.5]])
    np.testing.assert_allclose(np.column_stack([latitudes, longitudes]), PLACE.locate(cells), atol=1e-8)


def test_a_trajectory_is_a_line_of_longitudes_and_latitudes(tmp_path: Path) -> None:
    poses = np.array([[0.0, 0.0, 0.0], [10.0, 5.0, 0.1]])
    write_geojson(
        tmp_path / "trajectory.geojson", Trajectory(np.array([1_700_000_000_000_000, 1_700_000_000_250_000]), poses), PLACE
    )
    (feature,) = json.loads((tmp_path / "trajectory.geojson").read_text())["features"]
    np.testing.assert_allclose(feature["geometry"]["coordinates"], PLACE.locate(poses[:, :2])[:, ::-1], atol=1e-8)
    assert feature["properties"]["coordTimes"] == ["2023-11-14T22:13:20+00:00", "2023-11-14T22:13:20.250000+00:00"]


def test_a_trajectory_after_the_year_9999_has_no_times(tmp_path: Path) -> None:
    late = Trajectory(np.array([2**62 - 1, 2**62]), np.zeros((2, 3)))
    write_geojson(tmp_path / "trajectory.geojson", late, PLACE)
    (feature,) = json.loads((tmp_path / "trajectory.geojson").read_text())["features"]
    assert len(feature["geometry"]["coordinates"]) == 2 and feature["properties"] == {"name": "trajectory"}


def test_a_nav2_map_states_where_its_origin_lies(tmp_path: Path) -> None:
    write_nav2_map(tmp_path, make_grid(), PLACE)
    stated = yaml.safe_load((tmp_path / "map.yaml").read_text())["georeference"]
    latitude, longitude = PLACE.locate(np.zeros((1, 2)))[0]
    assert stated == pytest.approx({"latitude": latitude, "longitude": longitude, "yaw_from_east": 0.7})
    assert read_nav2_map(tmp_path / "map.yaml").resolution == 0.5
