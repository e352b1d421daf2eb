"""What is not installed is named with a command that installs it where mqslam came from."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mqslam.errors import DataError
from mqslam.execution import extras
from mqslam.execution.extras import describe_missing
from mqslam.formats.clouds import read_cloud

EXTRAS = {"open3d": "open3d", "pcd": "clouds", "las": "clouds", "view": "view", "cluster": "cluster"}


def command_of(library: str, monkeypatch: pytest.MonkeyPatch, source: dict[str, Any] | None) -> str:
    """Returns the command that is named if the installer left this note on where it took mqslam from."""

    class Installed:
        def read_text(self, name: str) -> str | None:
            return json.dumps(source) if source is not None and name == "direct_url.json" else None

    with monkeypatch.context() as patch:
        patch.setattr(metadata, "distribution", lambda name: Installed())
        return describe_missing(library)[1].removeprefix("install it with: ")


def test_every_library_is_in_an_extra_that_there_is() -> None:
    known = set(metadata.metadata("mqslam").get_all("Provides-Extra") or ())
    assert set(extras._LIBRARIES) == set(EXTRAS) and set(EXTRAS.values()) <= known
    assert {"all", *EXTRAS.values()} <= known


@pytest.mark.parametrize(("library", "extra"), EXTRAS.items())
def test_a_clone_is_named_by_its_folder(library: str, extra: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = {"url": tmp_path.as_uri(), "dir_info": {"editable": True}}
    assert command_of(library, monkeypatch, source) == f"{sys.executable} -m pip install -e '{tmp_path}[{extra}]'"


def test_a_clone_that_was_copied_is_not_installed_as_editable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "my clone"
    folder.mkdir()
    source = {"url": folder.as_uri(), "dir_info": {}}
    assert command_of("view", monkeypatch, source) == f"{sys.executable} -m pip install '{folder}[view]'"


def test_a_wheel_is_named_by_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wheel = tmp_path / "mqslam-1.0-py3-none-any.whl"
    wheel.touch()
    source = {"url": wheel.as_uri(), "archive_info": {}}
    assert command_of("las", monkeypatch, source) == f"{sys.executable} -m pip install '{wheel}[clouds]'"


def test_a_repository_is_named_with_the_commit(monkeypatch: pytest.MonkeyPatch) -> None:
    source = {"url": "https://example.org/mqslam.git", "vcs_info": {"vcs": "git", "commit_id": "12ab"}}
    command = command_of("cluster", monkeypatch, source)
    assert command.endswith("pip install 'mqslam[cluster] @ git+https://example.org/mqslam.git@12ab'")


@pytest.mark.parametrize("source", [None, {"url": "file:///nowhere/mqslam", "dir_info": {"editable": True}}])
def test_where_the_source_is_not_known_a_clone_is_named(
    source: dict[str, Any] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = command_of("open3d", monkeypatch, source)
    assert command.endswith("pip install -e '.[open3d]' in the folder of a clone of mqslam")


@pytest.mark.parametrize(("suffix", "hidden"), [(".pcd", "pypcd4.pypcd4"), (".las", "laspy"), (".laz", "lazrs")])
def test_a_cloud_names_the_extra_that_reads_it(
    suffix: str, hidden: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"cloud{suffix}"
    np.zeros(8).tofile(path)
    monkeypatch.setitem(sys.modules, hidden, None)
    with pytest.raises(DataError, match=rf"{re.escape(str(path))}: .* is not installed; install it with: .*\[clouds\]"):
        read_cloud(path)


def test_the_version_is_that_of_the_installation_and_costs_no_import_of_the_package() -> None:
    code = "import mqslam, sys; early = 'mqslam.version' in sys.modules; print(early, mqslam.__version__)"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.split() == ["False", metadata.version("mqslam")]
