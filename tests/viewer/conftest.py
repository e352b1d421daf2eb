"""A small finished run, and a screen where one can be had."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from mqslam.core.point_map import PointMap
from mqslam.core.trajectory import Trajectory
from mqslam.formats.ply import write_ply
from mqslam.formats.tum import write_tum


@pytest.fixture
def finished(tmp_path: Path) -> Path:
    """Five scans along a square, four points each but for the fourth, with a loop from the last to the first."""
    out = tmp_path / "result"
    out.mkdir()
    poses = np.array([[0, 0, 0], [10, 0, 1.5], [10, 10, 3], [0, 10, 4.5], [0.5, 1, 6]], dtype=np.float64)
    write_tum(out / "trajectory.tum", Trajectory(np.arange(7_000_000, 8_250_000, 250_000), poses))
    times = np.concatenate([0.25 * k + 0.05 * np.arange(4) for k in (0, 1, 2, 4)])
    corners = np.array([[-20.0, -15.0], [30.0, -15.0], [30.0, 25.0], [-20.0, 25.0]])
    ramp = np.linspace(0.0, 1.0, 16)
    intensities, psi = 40.0 + 160.0 * np.sqrt(ramp), 2.0 * (1.0 - ramp) ** 3
    points = np.concatenate([share * corners for share in (0.9, 0.7, 0.5, 0.3)])
    write_ply(out / "map.ply", PointMap(points, times, intensities, psi, np.ones(16, dtype=np.bool_)))
    edges = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 0)]
    lines = [f"VERTEX_SE2 {k} {x} {y} {yaw}" for k, (x, y, yaw) in enumerate(poses)]
    lines += [f"EDGE_SE2 {a} {b} 1 0 0 1 0 0 1 0 1" for a, b in edges]
    (out / "graph.g2o").write_text("\n".join(lines) + "\n")
    return out


@pytest.fixture
def no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine whose display is gone."""
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setenv("DISPLAY", ":4711")


@pytest.fixture(scope="session")
def screen() -> Iterator[dict[str, str]]:
    """The environment of a process with a screen that nobody sees."""
    if shutil.which("Xvfb") is None:
        pytest.skip("windows need Xvfb here: apt-get install xvfb libgl1-mesa-dri")
    read, write = os.pipe()
    command = ["Xvfb", "-displayfd", str(write), "-screen", "0", "1400x1000x24", "-noreset"]
    server = subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL)
    os.close(write)
    with os.fdopen(read) as number:
        display = number.readline().strip()
    environment = {name: value for name, value in os.environ.items() if name != "WAYLAND_DISPLAY"}
    try:
        yield {**environment, "DISPLAY": f":{display}"}
    finally:
        server.terminate()
        server.wait()
