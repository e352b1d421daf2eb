"""What the tests of several commands share."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from support.commands import mqslam

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.formats.tum import read_tum, write_tum


@pytest.fixture(scope="session")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A settings file that leaves nothing to be measured beforehand."""
    settings = tmp_path_factory.mktemp("settings") / "quick.yaml"
    settings.write_text("sensor: {doppler_beta: 0.0}\n")
    return settings


@pytest.fixture(scope="session")
def finished(street: Path, quick: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of the street along its odometry, whose recording counts its time from 1970; nobody may change it."""
    out = tmp_path_factory.mktemp("finished") / "run"
    assert mqslam("run", street, "--out", out, "--frontend", "odometry", "--config", quick, "--quiet").code == 0
    return out


@pytest.fixture
def other(finished: Path, tmp_path: Path) -> Path:
    """The same run with another setting and another verdict, 3 m farther to the left and turned by 0.1 rad."""
    copy = tmp_path / "other"
    shutil.copytree(finished, copy)
    settings = (copy / "config.yaml").read_text()
    assert "threshold: 40.0" in settings
    (copy / "config.yaml").write_text(settings.replace("threshold: 40.0", "threshold: 60.0"))
    summary = json.loads((copy / "summary.json").read_text())
    summary["frontend"], summary["runtime_s"]["total"] = "other", 1e6
    (copy / "summary.json").write_text(json.dumps(summary))
    track = read_tum(copy / "trajectory.tum")
    (copy / "trajectory.tum").unlink()
    write_tum(copy / "trajectory.tum", Trajectory(track.stamps_us, se2.compose([0.0, 3.0, 0.1], track.poses)))
    return copy
