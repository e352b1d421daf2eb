"""The command line as tests call it."""

from __future__ import annotations

import contextlib
import io
import sys
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from mqslam.cli import main


@dataclass(frozen=True)
class Result:
    """What a command left behind on the terminal."""

    code: int
    out: str
    err: str


def mqslam(*arguments: str | Path | float) -> Result:
    """Run the command line in this process; errors nobody foresaw are raised, as a traceback would show them."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    words = ["mqslam", *(str(argument) for argument in arguments)]
    with mock.patch.object(sys, "argv", words), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
    return Result(code, out.getvalue(), err.getvalue())


def contents(folder: Path) -> dict[str, bytes | None]:
    """Everything below a folder, hidden files too: bytes by name, None for folders."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))
    }
