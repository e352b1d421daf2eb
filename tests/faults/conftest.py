"""The drive that the tests of faults damage."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from support.faults import small_street, write_drive


@pytest.fixture(scope="session")
def lane(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Thirty coarse polar scans of a street, with ground truth; nobody may change it."""
    folder = tmp_path_factory.mktemp("lane") / "drive"
    write_drive(folder, small_street())
    return folder


@pytest.fixture
def drive(lane: Path, tmp_path: Path) -> Path:
    """A copy of the lane that a test may damage."""
    return shutil.copytree(lane, tmp_path / "drive")
