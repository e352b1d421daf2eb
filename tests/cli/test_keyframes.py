"""Keyframes of a map are written as points, or refused in a sentence."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from support.commands import mqslam
from support.keyframe_maps import two_recordings

from mqslam.formats.maps.keyframe_folder import write_keyframes
from mqslam.formats.ply import read_clock, read_ply
from mqslam.mapping.keyframing import render_keyframes


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder that holds keyframes and nothing else."""
    write_keyframes(tmp_path / "keyframes", two_recordings())
    return tmp_path / "keyframes"


def test_keyframes_become_points_where_the_map_has_them(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "map.ply"
    shown = mqslam("convert", folder, out)
    assert shown.code == 0 and f"wrote {out}" in shown.err
    points, columns = render_keyframes(two_recordings().keyframes), read_ply(out, ("x", "y", "intensity", "time", "psi"))
    np.testing.assert_allclose(np.column_stack([columns["x"], columns["y"]]), points.points, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(columns["intensity"], points.intensities, rtol=1e-6)
    np.testing.assert_allclose(columns["time"] - 1000.0, points.times, atol=1e-6)  # in the clock of the first recording
    assert np.isnan(columns["psi"]).all()
    clock = read_clock(out)
    assert clock is not None and (clock.start_us, clock.scan_us) == (0, 250_000)


def test_what_is_there_is_replaced_only_if_asked(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "map.ply"
    out.write_text("mine")
    assert mqslam("convert", folder, out).code == 2 and out.read_text() == "mine"
    assert mqslam("convert", folder, out, "--force", "--quiet").code == 0 and len(read_ply(out, ("x",))["x"]) == 12


@pytest.mark.parametrize("words", [["map.bag"], ["map"], ["map.ply", "--to", "native"]])
def test_keyframes_become_points_only(folder: Path, tmp_path: Path, words: list[str]) -> None:
    shown = mqslam("convert", folder, tmp_path / words[0], *words[1:])
    assert shown.code == 2 and re.search(r"which can only become a point cloud;\s+give\s+an\s+output", shown.err)
    assert not (tmp_path / words[0]).exists()
    shown = mqslam("convert", tmp_path, tmp_path / words[0])  # the folder above holds no trajectory, as a merged map's
    assert shown.code == (0 if words[0] == "map.ply" else 2)
    assert shown.code == 0 or f"{tmp_path}: is a merged map, of which only the keyframes can be converted" in shown.err
    assert shown.code == 0 or "(its trajectories are in TUM already: trajectory_1.tum and so on); give" in shown.err


def test_damaged_keyframes_leave_no_file(folder: Path, tmp_path: Path) -> None:
    (folder / "points.npy").write_bytes(b"")
    shown = mqslam("convert", folder, tmp_path / "map.ply")
    assert shown.code == 2 and "points.npy" in shown.err and not (tmp_path / "map.ply").exists()
