"""Chooses where numba keeps compiled kernels: beside the code, else in the user's cache, else in a temporary folder.

Numba itself chooses one of the first two folders. If numba can write to neither, as in a read-only container, it would
refuse to compile at all.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

_CODE = Path(__file__).parents[1]


def choose_cache() -> None:
    """Sets a folder for compiled kernels if numba could write to none; child processes of this process use it, too."""
    if "NUMBA_CACHE_DIR" not in os.environ and not any(map(_is_writable, (_CODE, *_list_user_caches()))):
        os.environ["NUMBA_CACHE_DIR"] = str(_make_folder())


def _list_user_caches() -> list[Path]:
    """Returns the folder that numba uses as the user's cache, in a list, which is empty for a user without a home folder."""
    named = os.environ.get("XDG_CACHE_HOME")
    if named:
        return [Path(named)]
    try:
        return [Path.home() / ".cache"]
    except RuntimeError:
        return []


def _is_writable(folder: Path) -> bool:
    """Returns whether files can be made in a folder, which need not exist yet."""
    there = next((parent for parent in (folder, *folder.parents) if parent.exists()), None)
    return there is not None and os.access(there, os.W_OK)


def _make_folder() -> Path:
    """Returns a temporary folder that nobody else can write to, because the kernels in it are executed."""
    own = Path(tempfile.gettempdir()) / f"mqslam-kernels-{os.getuid()}"
    try:
        own.mkdir(mode=0o700, exist_ok=True)
        found = own.lstat()
        is_private = found.st_uid == os.getuid() and not found.st_mode & 0o077
    except OSError:
        is_private = False
    return own if is_private and own.is_dir() and not own.is_symlink() else Path(tempfile.mkdtemp(prefix="mqslam-kernels-"))
