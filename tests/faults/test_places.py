"""Places that tell too little, and recordings too short to be judged."""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import gtsam
import numpy as np
import pytest
from support.commands import mqslam, parse_strict_json
from support.faults import images, run_quickly

from mqslam.backend.marginals import PoseCovariances, compute_all_marginals
from mqslam.backend.pose_graph import PoseGraph
from mqslam.core import frontend
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement, Status
from mqslam.core.scans import Scan
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import write_tum


class Tunnel:
    """Motions as a bare tunnel tells them: to a hair across, and not at all along."""

    def __init__(self, context: Context) -> None: ...

    def measure(self, scans: list[Scan]) -> Iterator[Measurement]:
        for a, b in itertools.pairwise(scans):
            axes = np.array([[np.cos(0.3), -np.sin(0.3), 0.0], [np.sin(0.3), np.cos(0.3), 0.0], [0.0, 0.0, 1.0]])
            covariance = axes @ np.diag([1e10, 1e-10, 1e-10]) @ axes.T
            yield Measurement(a.t0, b.t0, np.array([2.0, 0.0, 0.0]), covariance, Status.DEGENERATE)


@pytest.mark.parametrize("odometry", ["none", "wheels"])
def test_a_tunnel_that_tells_nothing_along_it(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, odometry: str
) -> None:
    wheels = tmp_path / "wheels.tum"
    write_tum(wheels, open_recording(drive).ground_truth)
    load, seen = frontend.load, []

    def watched(result: PoseGraph, values: gtsam.Values) -> PoseCovariances:
        seen.append((result.factors, values))
        return compute_all_marginals(result, values)

    monkeypatch.setattr(frontend, "load", lambda name: Tunnel if name == "psi" else load(name))
    monkeypatch.setattr("mqslam.slam.compute_all_marginals", watched)
    shown = run_quickly(drive, tmp_path / "out", "--odometry", wheels if odometry == "wheels" else "none")
    assert shown.code == 0 and "warning: the scans did not observe every direction from 0.0 s to 7.2 s" in shown.err
    assert "could not be completed" not in shown.err and "not known" not in shown.err
    for name in ("report.html", "trajectory.tum", "covariances.csv"):
        assert (tmp_path / "out" / name).is_file()
    if odometry == "none":  # where GTSAM's own marginals end with an exception
        with pytest.raises(RuntimeError, match="Indeterminate linear system"):
            gtsam.Marginals(*seen[0])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])  # of the first the covariances are beyond GTSAM's own marginals
def test_the_twins_tunnel(tmp_path: Path, seed: int) -> None:
    """Poles, 220 m of bare walls, poles."""
    twin = Path(__file__).parents[3] / "shared" / "twin"
    if not twin.is_dir():
        pytest.skip(f"the twin is not at {twin}")
    tunnel = tmp_path / "tunnel"
    subprocess.run([sys.executable, twin / "worlds.py", tmp_path / "worlds"], check=True)
    words = ["tunnel", tunnel, "--data", tmp_path / "worlds", "--seed", str(seed)]
    subprocess.run([sys.executable, twin / "make_twin.py", *words], check=True)
    for odometry in ("none", "auto"):
        out = tmp_path / odometry
        assert mqslam("run", tunnel, "--out", out, "--odometry", odometry, "--jobs", "1", "--quiet").code == 0
        result = parse_strict_json((out / "summary.json").read_text())
        assert result["verdict"]["status"] in ("warn", "fail") and "every direction" in str(result["verdict"]["reasons"])
        assert not [warning for warning in result["warnings"] if "could not" in warning or "not known" in warning]
        assert "ellipses" in (out / "report.html").read_text(encoding="utf-8")


def test_a_recording_of_two_scans(drive: Path, tmp_path: Path) -> None:
    for image in images(drive)[2:]:
        image.unlink()
    stamps = drive / "radar.timestamps"
    stamps.write_text("".join(stamps.read_text().splitlines(keepends=True)[:2]))
    shown = run_quickly(drive, tmp_path / "out")
    assert shown.code == 0 and "verdict: not judged: 2 scans are too few to judge a map by: a window takes 6" in shown.out
    result = parse_strict_json((tmp_path / "out" / "summary.json").read_text())
    assert result["verdict"]["status"] == "not judged" and result["inflation"]["windows"] == 0
    assert "not judged" in (tmp_path / "out" / "report.html").read_text()
