from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from PIL import Image

from mqslam.formats.maps.nav2_map import write_nav2_map
from mqslam.mapping import occupancy_grid as module
from mqslam.mapping.occupancy_grid import make_occupancy_grid

CELL_M = 0.2


def wall_and_stray(times_seen: int = 9) -> NDArray[np.float64]:
    """Returns a wall along y = 0.1 m from x = 0.1 to 9.9 m, each 0.2 m seen several times, and a stray return at (5, 6)."""
    wall = np.c_[np.arange(0.1, 10.0, 0.2), np.full(50, 0.1)]
    return np.vstack([np.repeat(wall, times_seen, axis=0), [[5.1, 6.1]]])


def meaning(pixel: int, settings: dict[str, float]) -> str:
    """Returns the meaning of a pixel for map_server in trinary mode."""
    occupancy = (255 - pixel) / 255
    if occupancy > settings["occupied_thresh"]:
        return "occupied"
    return "free" if occupancy < settings["free_thresh"] else "unknown"


def test_map_server_finds_the_wall_where_it_stands(tmp_path: Path) -> None:
    write_nav2_map(tmp_path, make_occupancy_grid(wall_and_stray() + np.array([-3.0, 20.0]), CELL_M))
    settings = yaml.safe_load((tmp_path / "map.yaml").read_text())
    assert set(settings) == {"image", "mode", "resolution", "origin", "negate", "occupied_thresh", "free_thresh"}
    assert (settings["mode"], settings["negate"], settings["resolution"]) == ("trinary", 0, 0.2)
    assert (tmp_path / settings["image"]).read_bytes().startswith(b"P5\n")
    image = np.asarray(Image.open(tmp_path / settings["image"]))
    rows, columns = np.nonzero(image == 0)
    x = settings["origin"][0] + (columns + 0.5) * 0.2
    y = settings["origin"][1] + (image.shape[0] - rows - 0.5) * 0.2
    np.testing.assert_allclose(np.sort(x), np.arange(0.1, 10.0, 0.2) - 3.0, atol=1e-9)
    np.testing.assert_allclose(y, 20.1, atol=1e-9)


def test_a_stray_return_is_unknown_and_nothing_is_free(tmp_path: Path) -> None:
    write_nav2_map(tmp_path, make_occupancy_grid(wall_and_stray(), CELL_M))
    settings = yaml.safe_load((tmp_path / "map.yaml").read_text())
    image = np.asarray(Image.open(tmp_path / "map.pgm"))
    meanings = {meaning(int(pixel), settings) for pixel in np.unique(image)}
    assert meanings == {"occupied", "unknown"}
    assert np.count_nonzero(image == 0) == 50


def test_cells_seen_once_count_where_no_cell_is_seen_more_often() -> None:
    assert make_occupancy_grid(wall_and_stray(times_seen=1), CELL_M).occupied.sum() == 51


def test_a_grid_that_would_be_too_long_gets_coarser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_SIDE", 100)
    grid = make_occupancy_grid(np.array([[-1000.03, 0.0], [999.98, 0.0], [0.0, 40.0]]), CELL_M)
    assert 90 <= max(grid.occupied.shape) <= 100
    assert grid.resolution == pytest.approx(2000.0 / 98, rel=1e-3)
    assert grid.occupied.sum() == 3


def test_an_empty_map_is_one_unknown_cell(tmp_path: Path) -> None:
    write_nav2_map(tmp_path, make_occupancy_grid(np.empty((0, 2)), CELL_M))
    assert np.asarray(Image.open(tmp_path / "map.pgm")).tolist() == [[205]]
