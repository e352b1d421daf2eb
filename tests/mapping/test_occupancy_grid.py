from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from PIL import Image

from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.keyframes import MappedRecording
from mqslam.core.recording import stamp_scans
from mqslam.core.scans import Returns
from mqslam.errors import DataError
from mqslam.formats.maps.nav2_map import read_nav2_map, write_nav2_map
from mqslam.mapping import occupancy_grid as module
from mqslam.mapping.keyframing import make_keyframes
from mqslam.mapping.occupancy_grid import make_occupancy_grid, mark_free, mark_free_by_keyframes
from mqslam.psi.place import beam_of

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


@pytest.mark.parametrize("header", [b"P5\n3 2\n255\n", b"P5\n# made by hand\n3 2 # wide and high\n#\n255\n", b"P5 3 2 255 "])
def test_a_picture_with_comments_is_read(tmp_path: Path, header: bytes) -> None:
    write_nav2_map(tmp_path, make_occupancy_grid(np.empty((0, 2)), CELL_M))
    (tmp_path / "map.pgm").write_bytes(header + bytes([10, 32, 254, 205, 35, 0]))
    assert read_nav2_map(tmp_path / "map.yaml").cells.tolist() == [[-1, 100, 100], [100, 100, 0]]


@pytest.mark.parametrize("content", [b"P2\n1 1\n255\n0", b"P5\n1 1\n65535\n00", b"P5\n1 1\n15\n0", b"P5\n#", b""])
def test_a_picture_of_another_kind_is_refused(tmp_path: Path, content: bytes) -> None:
    write_nav2_map(tmp_path, make_occupancy_grid(np.empty((0, 2)), CELL_M))
    (tmp_path / "map.pgm").write_bytes(content)
    with pytest.raises(DataError, match=r"its image is no binary PGM \(P5\) of pixels from 0 to 255"):
        read_nav2_map(tmp_path / "map.yaml")


def test_keyframes_of_a_lidar_free_the_cells_that_its_scans_free() -> None:
    azimuths = np.linspace(-1.5, 1.5, 301)
    returns = Returns(4.0 / np.cos(azimuths / 2.0), azimuths, np.zeros(301), np.ones(301))
    scans = stamp_scans(np.array([0, 1_000_000]), [returns, replace(returns, times=np.ones(301))])
    poses = np.array([[0.0, 0.0, 0.3], [3.0, 1.0, 0.8]])
    beam = beam_of(Config().estimator, 0.0)
    keyframes = make_keyframes(scans, poses, None, MappedRecording("log", 0, 1_000_000, 1.0, 0.0, 1.0), beam)
    ends = [
        se2.transform(pose, np.column_stack([np.cos(azimuths), np.sin(azimuths)]) * returns.ranges[:, None])
        for pose in poses
    ]
    grid = make_occupancy_grid(np.concatenate(ends), CELL_M)
    by_scans, by_keyframes = mark_free(grid, scans, poses), mark_free_by_keyframes(grid, keyframes)
    assert by_scans.free is not None and by_keyframes.free is not None
    assert by_scans.free.sum() > 500 and not np.any(by_keyframes.free & grid.occupied)
    assert np.mean(by_scans.free != by_keyframes.free) < 0.01
