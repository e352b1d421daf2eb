"""The pages of small results, each written once."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.pages import WRITERS


@pytest.fixture(scope="session")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The folder of the page of each command."""
    folders = {name: tmp_path_factory.mktemp(name) for name in WRITERS}
    for name, write in WRITERS.items():
        assert write(folders[name]) == []
    return folders
