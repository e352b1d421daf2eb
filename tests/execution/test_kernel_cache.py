"""Where compiled kernels are kept on machines that numba would refuse to compile on."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from mqslam.execution import kernel_cache

COMPILE = (
    "import mqslam, numba, numpy as np\n"
    "from mqslam.core.motion import raise_to\n"
    "print(type(raise_to._cache).__name__, raise_to._cache.cache_path)"
)


@pytest.fixture
def read_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A machine on which only the folder for temporary files can be written to."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(kernel_cache, "_is_writable", lambda folder: False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    yield tmp_path
    os.environ.pop("NUMBA_CACHE_DIR", None)


def test_numba_chooses_where_it_can_write(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    kernel_cache.choose_cache()
    assert "NUMBA_CACHE_DIR" not in os.environ


def test_what_the_user_has_chosen_stays(read_only: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", "elsewhere")
    kernel_cache.choose_cache()
    assert os.environ["NUMBA_CACHE_DIR"] == "elsewhere"


def test_where_nothing_can_be_written_a_private_folder_is_found_again(read_only: Path) -> None:
    kernel_cache.choose_cache()
    first = Path(os.environ.pop("NUMBA_CACHE_DIR"))
    kernel_cache.choose_cache()
    assert Path(os.environ["NUMBA_CACHE_DIR"]) == first
    assert first.parent == read_only and first.stat().st_mode & 0o777 == 0o700


def test_a_folder_that_others_can_write_to_is_not_trusted(read_only: Path) -> None:
    kernel_cache.choose_cache()
    theirs = Path(os.environ.pop("NUMBA_CACHE_DIR"))
    theirs.chmod(0o777)
    kernel_cache.choose_cache()
    assert Path(os.environ["NUMBA_CACHE_DIR"]) != theirs


def test_kernels_are_kept_in_the_folder_that_is_named(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    shown = subprocess.run([sys.executable, "-c", COMPILE], env=environment, capture_output=True, text=True, check=True)
    assert str(tmp_path) in shown.stdout


def test_a_user_without_a_home_and_a_name_can_work(read_only: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As containers have them: a number that nobody has given a name or a folder."""
    program = (
        "import pwd; pwd.getpwuid = {}.__getitem__; import mqslam; from mqslam.core.motion import raise_to; print('done')"
    )
    left = {name: value for name, value in os.environ.items() if name in ("PATH", "PYTHONPATH")}
    shown = subprocess.run([sys.executable, "-c", program], env=left, cwd=read_only, capture_output=True, text=True)
    assert shown.stdout == "done\n" and list(read_only.iterdir()) == [], shown.stderr
    for name in ("HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", {}.__getitem__)
    monkeypatch.setattr(kernel_cache, "_is_writable", lambda folder: folder != kernel_cache._CODE)
    kernel_cache.choose_cache()
    assert Path(os.environ["NUMBA_CACHE_DIR"]).parent == read_only
