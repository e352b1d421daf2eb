"""The command line as tests call it."""

from __future__ import annotations

import contextlib
import io
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

from mqslam.cli import main
from mqslam.execution import local_engine

INSTALLED = Path(sys.executable).with_name("mqslam")


@dataclass(frozen=True)
class Result:
    """The exit code of a command, and what it wrote to the terminal."""

    code: int
    out: str
    err: str


def mqslam(*arguments: str | Path | float) -> Result:
    """Runs the command line in this process; unforeseen errors are raised, as a traceback would show them."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    words = ["mqslam", *(str(argument) for argument in arguments)]
    with mock.patch.object(sys, "argv", words), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
    return Result(code, out.getvalue(), err.getvalue())


def parse_strict_json(text: str) -> dict[str, Any]:
    """Returns the content of JSON as other languages read it: without NaN and Infinity."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    content: dict[str, Any] = json.loads(text, parse_constant=refuse)
    return content


def read_summary(out: Path, name: str = "summary.json") -> dict[str, Any]:
    """Returns the content of the summary in a folder of results."""
    return parse_strict_json((out / name).read_text())


@contextlib.contextmanager
def run_in_this_process() -> Iterator[None]:
    """Calls functions in this process instead of a process of their own, which would import everything again."""
    with mock.patch.object(local_engine, "_call_apart", lambda function, shared, item: function(shared, item)):
        yield


def read_contents(folder: Path) -> dict[str, bytes | None]:
    """Returns everything below a folder, hidden files too: bytes by name, None for folders."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))
    }


def list_processes(session: int) -> list[Path]:
    """Returns the processes of a session that are still alive after they had a minute to end."""
    end = time.monotonic() + 60.0
    while alive := [stat for stat in Path("/proc").glob("[0-9]*/stat") if _in_session(stat, session)]:
        if time.monotonic() > end:
            break
        time.sleep(0.05)
    return alive


def _in_session(stat: Path, session: int) -> bool:
    """Returns whether a process exists, belongs to a session and is not a zombie."""
    try:
        words = stat.read_text().rpartition(")")[2].split()
    except OSError:
        return False
    return int(words[3]) == session and words[0] != "Z"
