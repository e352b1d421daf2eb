"""What is not installed is named with a command that installs it where mqslam came from."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mqslam.errors import DataError
from mqslam.execution import extras
from mqslam.execution.extras import describe_missing
from mqslam.formats.clouds import read_cloud

EXTRAS = {
    "open3d": "open3d",
    "small_gicp": "small-gicp",
    "pcd": "clouds",
    "las": "clouds",
    "view": "view",
    "cluster": "cluster",
}


def test_every_library_is_in_an_extra_that_there_is() -> None:
    known = set(metadata.metadata("mqslam").get_all("Provides-Extra") or ())
    assert set(extras._LIBRARIES) == set(EXTRAS) and set(EXTRAS.values()) <= known
    assert {"all", *EXTRAS.values()} <= known


@pytest.mark.parametrize(
    ("library", "source", "target"),
    [
        *((name, {"dir_info": {"editable": True}}, f"-e '{{place}}[{extra}]'") for name, extra in EXTRAS.items()),
        ("view", {"dir_info": {}}, "'{place}[view]'"),  # a clone that was copied
        ("las", {"archive_info": {}}, "'{place}[clouds]'"),  # a wheel
        ("cluster", {"vcs_info": {"commit_id": "12ab"}}, "'mqslam[cluster] @ git+file://{place}@12ab'"),
        ("open3d", {"url": "file:///nowhere/mqslam", "dir_info": {}}, "-e '.[open3d]' in the folder of a clone of mqslam"),
        ("open3d", None, "-e '.[open3d]' in the folder of a clone of mqslam"),
    ],
)
def test_the_command_installs_from_where_mqslam_came(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, library: str, source: dict[str, Any] | None, target: str
) -> None:
    place = tmp_path / "mine"
    place.mkdir()
    note = None if source is None else json.dumps({"url": place.as_uri()} | source)
    installed = SimpleNamespace(read_text=lambda name: note if name == "direct_url.json" else None)
    with monkeypatch.context() as patch:
        patch.setattr(metadata, "distribution", lambda name: installed)
        remedy = describe_missing(library)[1]
    assert remedy == f"install it with: {sys.executable} -m pip install {target.format(place=place)}"


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
