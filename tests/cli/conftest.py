"""What the tests of several commands share."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.commands import mqslam


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
