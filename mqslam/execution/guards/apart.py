"""Reads untrusted files in separate processes of bounded memory and time, so that a bad file crashes only such a process."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from typing import Final, NoReturn

from mqslam.execution.guards.memory import bound_memory

_PATIENCE_S: Final = 600.0  # longest time that such a process may take
_REFUSED: Final = 3  # exit code of a process whose function failed with an error, which it has written to stderr
_ONE_THREAD: Final = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}


class ProcessFailed(Exception):
    """Raised if a separate process died, took too long or raised an error; the message states the cause."""


def call_apart(function: Callable[[list[str]], bytes], words: list[str], content: bytes = b"", *, most_bytes: int) -> bytes:
    """Calls a function of a module in a new process, and returns the function's result.

    The new process imports nothing from the user's current folder, where anybody may have put a module.

    Args:
        function: the function; it takes the words, may read stdin, and must not print.
        words: the function's argument, which travels on the command line of the process.
        content: bytes that the function can read from stdin.
        most_bytes: largest memory that the process may take [bytes].

    Raises:
        ProcessFailed: the process died, took too long, or raised an error.
    """
    code = f"from {__name__} import answer; from {function.__module__} import {function.__name__} as f; answer(f)"
    command = [sys.executable, "-P", "-c", code, str(most_bytes), *words]
    try:
        done = subprocess.run(
            command, input=content, capture_output=True, timeout=_PATIENCE_S, env=os.environ | _ONE_THREAD, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise ProcessFailed("it takes too long") from error
    except OSError as error:
        raise ProcessFailed(error.strerror or str(error)) from error
    if done.returncode == _REFUSED:
        raise ProcessFailed(done.stderr.decode("utf-8", "replace").strip())
    if done.returncode != 0:
        raise ProcessFailed("the library that reads it crashed")
    return done.stdout


def answer(function: Callable[[list[str]], bytes]) -> NoReturn:
    """Calls a function in the process that `call_apart` has started, writes the result to stdout, and ends the process."""
    bound_memory(int(sys.argv[1]))
    try:
        content = function(sys.argv[2:])
    except BaseException as error:  # libraries in Rust raise panics, which are no Exception
        lines = str(error).splitlines() or [type(error).__name__]
        os.write(2, lines[0][:200].encode("utf-8", "replace"))
        os._exit(_REFUSED)
    sys.stdout.buffer.write(content)
    sys.stdout.flush()
    os._exit(0)  # at once, since a library that has read a damaged file may crash at a normal exit
