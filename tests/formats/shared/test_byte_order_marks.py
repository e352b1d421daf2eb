"""Text files that begin with a byte order mark, as some editors write them, are read as those without it."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mqslam.config import Config
from mqslam.config.yaml_file import parse_yaml
from mqslam.formats.graphs.g2o import read_g2o
from mqslam.formats.lidars.carmen import read_lidar
from mqslam.formats.recordings import open_recording
from mqslam.formats.recordings.radiate import read_listing
from mqslam.formats.sensors.csv_files import read_transform
from mqslam.formats.trajectories import read_odometry, read_trajectory

MARK = b"\xef\xbb\xbf"
POSES = "".join(f"{k}.5 {k} 0 0 0 0 0 1\n" for k in range(3))
SCANS = "".join(f"FLASER 180 {' '.join(str(1 + k / 180) for k in range(180))} {t} 0 0 {t} 0 0 {t} h {t}\n" for t in (1, 2))
GRAPH = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"


@pytest.mark.parametrize(
    ("name", "text", "read"),
    [
        ("a.tum", POSES, lambda path: read_trajectory(path).poses),
        ("a.tum", POSES, lambda path: read_odometry(path).poses),
        ("a.csv", "t,v,omega\n0,1,0\n1000000,1,0\n", lambda path: read_odometry(path).poses),
        ("a.csv", "t,x,y,yaw\n0,1,0,0\n1000000,2,0,0\n", lambda path: read_trajectory(path).poses),
        ("a.txt", "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", read_transform),
        ("a.txt", "Frame: 000001 Time: 1574859771.744660272\n", lambda path: read_listing(path)[1]),
        ("a.g2o", GRAPH, lambda path: np.array(read_g2o(path).keys)),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_mark_changes_nothing(tmp_path: Path, encoding: str, name: str, text: str, read: Callable[[Path], Any]) -> None:
    plain, marked = tmp_path / f"plain_{name}", tmp_path / f"marked_{name}"
    plain.write_text(text)
    marked.write_bytes(text.encode(encoding))
    np.testing.assert_array_equal(read(marked), read(plain))


@pytest.mark.parametrize(("name", "pack"), [("a.log", bytes), ("a.log.gz", gzip.compress)])
def test_a_mark_in_a_carmen_log_changes_nothing(tmp_path: Path, name: str, pack: Callable[[bytes], bytes]) -> None:
    (tmp_path / name).write_bytes(pack(MARK + SCANS.encode()))
    assert len(read_lidar(tmp_path / name).scans) == 2


def test_a_mark_in_settings_changes_nothing() -> None:
    text = "sensor: {clockwise: false}\n"
    assert parse_yaml(Config, "a.yaml", MARK + text.encode()) == parse_yaml(Config, "a.yaml", text)


def test_a_mark_before_the_stamps_of_images_changes_nothing(oxford: Path) -> None:
    listing = oxford / "radar.timestamps"
    plain = open_recording(oxford)
    listing.write_bytes(MARK + listing.read_bytes())
    marked = open_recording(oxford)
    np.testing.assert_array_equal(marked.stamps_us, plain.stamps_us)
    assert marked.faults == plain.faults


@pytest.mark.parametrize("per_s", [1e3, 1e6, 1e9])
def test_stamps_of_tum_files_in_other_units_than_seconds_are_read(tmp_path: Path, per_s: float) -> None:
    (tmp_path / "a.tum").write_text("".join(f"{int((1.7e9 + 0.25 * k) * per_s)} {k} 0 0 0 0 0 1\n" for k in range(3)))
    for read in (read_trajectory, read_odometry):
        np.testing.assert_array_equal(read(tmp_path / "a.tum").stamps_us, 1_700_000_000_000_000 + 250_000 * np.arange(3))
