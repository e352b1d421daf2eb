"""A function in a process of its own: what it returns comes back, and whatever happens to it is an error."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from mqslam.execution.guards import apart
from mqslam.execution.guards.apart import ProcessFailed, call_apart

MOST = 1 << 30


def repeat(words: list[str]) -> bytes:
    return (sys.stdin.read() * int(words[0])).encode()


def crash(words: list[str]) -> bytes:
    os.kill(os.getpid(), signal.SIGSEGV)
    return b""


def fill(words: list[str]) -> bytes:
    return np.ones(1 << 31, dtype=np.uint8).tobytes()


def fail(words: list[str]) -> bytes:
    raise ValueError(f"no {words[0]}\nand more")


def wait(words: list[str]) -> bytes:
    signal.pause()
    return b""


@pytest.fixture(autouse=True)
def importable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets the process find this module."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    for function in (repeat, crash, fill, fail, wait):
        monkeypatch.setattr(function, "__module__", "test_apart")


def test_what_the_function_returns_comes_back() -> None:
    assert call_apart(repeat, ["2"], b"ab", most_bytes=MOST) == b"abab"


def test_whatever_happens_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ProcessFailed, match=r"^no luck$"):
        call_apart(fail, ["luck"], most_bytes=MOST)
    with pytest.raises(ProcessFailed, match="the library that reads it crashed"):
        call_apart(crash, [], most_bytes=MOST)
    with pytest.raises(ProcessFailed, match="allocate"):
        call_apart(fill, [], most_bytes=MOST)
    monkeypatch.setattr(apart, "_PATIENCE_S", 2.0)
    with pytest.raises(ProcessFailed, match="takes too long"):
        call_apart(wait, [], most_bytes=MOST)


def test_nothing_is_imported_from_the_folder_that_the_user_works_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "numpy.py").write_text("import os\nos._exit(99)\n")
    (tmp_path / "mqslam.py").write_text("import os\nos._exit(99)\n")
    monkeypatch.chdir(tmp_path)
    assert call_apart(repeat, ["1"], b"ab", most_bytes=MOST) == b"ab"
