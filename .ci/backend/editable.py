"""The build backend: setuptools, whose editable installs also hold the package as one folder.

The package's parts lie in several folders of the repository, which setuptools joins by an import hook. Python asks that
hook only after every folder on its path, so that a folder named `mqslam` in the working directory, such as a clone, hides
the package; and type checkers run no hooks. A folder of links, on Python's path, mends both. A new file or folder directly
in `mqslam/` needs another install; everything below these is seen at once.
"""

from __future__ import annotations

import base64
import hashlib
import shutil
import zipfile
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403 - the hooks that stay as they are

ROOT = Path(__file__).resolve().parents[2]
TREE = ROOT / ".editable"
PARTS = ("frontends", "factors", "configs")


def build_editable(wheel_directory: str, config_settings: Any = None, metadata_directory: str | None = None) -> str:
    """Builds the wheel of an editable install, with the folder of links on Python's path; returns the wheel's name."""
    name = build_meta.build_editable(wheel_directory, config_settings, metadata_directory)
    make_tree()
    path = Path(wheel_directory, name)
    with zipfile.ZipFile(path) as wheel:
        files = {file: wheel.read(file) for file in wheel.namelist()}
    record = next(file for file in files if file.endswith(".dist-info/RECORD"))
    files["mqslam_links.pth"] = f"{TREE}\n".encode()
    files[record] = "".join(f"{file},{describe(content)}\n" for file, content in files.items() if file != record).encode()
    files[record] += f"{record},,\n".encode()
    with zipfile.ZipFile(path, "w") as wheel:
        for file, content in files.items():
            wheel.writestr(file, content)
    return name


def describe(content: bytes) -> str:
    """Returns the hash and the size of a file, as a wheel records them."""
    digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
    return f"sha256={digest},{len(content)}"


def make_tree() -> None:
    """Makes the folder of links anew."""
    shutil.rmtree(TREE, ignore_errors=True)
    (TREE / "mqslam").mkdir(parents=True)
    parts = [*(ROOT / "mqslam").iterdir(), *(ROOT / part for part in PARTS)]
    for part in parts:
        if part.name != "__pycache__":
            (TREE / "mqslam" / part.name).symlink_to(part)
