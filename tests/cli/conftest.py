"""What the tests of several commands share."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A settings file that leaves nothing to be measured beforehand."""
    settings = tmp_path_factory.mktemp("settings") / "quick.yaml"
    settings.write_text("sensor: {doppler_beta: 0.0}\n")
    return settings
