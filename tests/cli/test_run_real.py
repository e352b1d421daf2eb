"""A run of the real sample follows the radar, and gives the same trajectory from a bag."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from support.commands import mqslam
from support.parameters import mostly_slow
from support.recordings import KINDS, bag_path, write_bag

from mqslam.formats.recordings import open_recording


@pytest.fixture(scope="module")
def real(oxford_tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The real sample's results, without odometry."""
    out = tmp_path_factory.mktemp("real") / "out"
    assert mqslam("run", oxford_tiny, "--odometry", "none", "--out", out, "--quiet").code == 0
    return out


def test_real_radar_is_followed_without_odometry(real: Path, oxford_tiny: Path) -> None:
    judge = oxford_tiny.parents[1] / "tools" / "score_run.py"
    if not judge.is_file():
        pytest.skip(f"no {judge}")
    command = [sys.executable, judge, real / "trajectory.tum", oxford_tiny / "gt" / "radar_odometry.csv", "--json"]
    score = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert score["stamps"] >= 10
    assert score["rpe_v_rms"] <= 0.40 and score["rpe_w_rms"] <= 0.012


@pytest.mark.parametrize("kind", mostly_slow(KINDS, ("ros1",)))
def test_a_bag_of_real_polar_scans_gives_the_same_trajectory(
    real: Path, oxford_tiny: Path, tmp_path: Path, kind: str
) -> None:
    bag = write_bag(open_recording(oxford_tiny), bag_path(tmp_path, kind), kind)
    settings = real / "config.yaml"  # what the run of the sample used, whatever of it was measured
    options = ["--odometry", "none", "--config", settings, "--range-resolution", "0.0438", "--quiet"]
    assert mqslam("run", bag, "--out", tmp_path / "out", *options).code == 0
    assert (tmp_path / "out" / "trajectory.tum").read_bytes() == (real / "trajectory.tum").read_bytes()
