"""Lists the versions of installed libraries, and names the commands that install optional libraries."""

from __future__ import annotations

import json
import platform
import shlex
import sys
from importlib import metadata
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote, urlparse

_LIBRARIES: Final = {  # name for messages and extra in pyproject.toml, by the names that `describe_missing` takes
    "open3d": ("Open3D", "open3d"),
    "small_gicp": ("small_gicp", "small-gicp"),
    "pcd": ("pypcd4", "clouds"),
    "las": ("laspy with lazrs", "clouds"),
    "view": ("Rerun", "view"),
    "cluster": ("Dask", "cluster"),
}
# names of the packages that results depend on
_DECIDING: Final = ("numpy", "scipy", "numba", "gtsam", "open3d", "kiss-icp", "small_gicp", "matplotlib")


def list_versions() -> list[str]:
    """Returns the versions of Python and of the installed libraries that results depend on, such as `numpy 2.3.1`."""
    versions = [f"Python {platform.python_version()}"]
    for package in _DECIDING:
        try:
            versions.append(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            continue
    return versions


def describe_missing(library: str) -> tuple[str, str]:
    """Returns the two parts of an error's message: that a library is not installed, and the command that installs it.

    Args:
        library: `open3d`, `small_gicp`, `pcd`, `las`, `view` or `cluster`.
    """
    name, extra = _LIBRARIES[library]
    return f"{name} is not installed", f"install it with: {_name_command(extra)}"


def _name_command(extra: str) -> str:
    """Returns a command that installs an extra of mqslam from the same clone, wheel or repository as mqslam itself.

    The installer wrote this source to `direct_url.json` (PEP 610). Without this file, mqslam came from a package index.
    The index of this machine may not have mqslam, so the command then asks for a clone.
    """
    pip = f"{shlex.quote(sys.executable)} -m pip install"
    source = _read_source()
    url = str(source.get("url", ""))
    if "vcs_info" in source:
        vcs = source["vcs_info"]
        target = f"mqslam[{extra}] @ {vcs.get('vcs', 'git')}+{url}@{vcs.get('commit_id', 'HEAD')}"
        return f"{pip} {shlex.quote(target)}"
    place = Path(unquote(urlparse(url).path))
    if url.startswith("file://") and place.exists():
        editable = "-e " if source.get("dir_info", {}).get("editable") else ""
        return f"{pip} {editable}{shlex.quote(f'{place}[{extra}]')}"
    return f"{pip} -e '.[{extra}]' in the folder of a clone of mqslam"


def _read_source() -> dict[str, Any]:
    """Returns the content of `direct_url.json`, which states the source of mqslam; empty if the installer wrote none."""
    try:
        text = metadata.distribution("mqslam").read_text("direct_url.json")
        source = json.loads(text or "{}")
    except (metadata.PackageNotFoundError, ValueError):
        return {}
    return source if isinstance(source, dict) else {}
