"""Writes result files: each is written under a temporary name and then renamed, so that it is complete or absent."""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mqslam.errors import OutputError, Remedy, show_lines


@contextlib.contextmanager
def blame_output(path: Path, done: str, remedy: Remedy) -> Iterator[None]:
    """Turns an OSError of the block into the error that `path` cannot be `done` ("made" or "written"); it advises `remedy`.

    Raises:
        OutputError: the block raised an OSError.
    """
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path}: cannot be {done} ({error.strerror})", remedy) from error


@contextlib.contextmanager
def write_aside(path: Path) -> Iterator[Path]:
    """Yields a temporary path beside `path`; the file there is renamed to `path` when the block ends without an error.

    The content is flushed to the disk before the file is renamed. The permissions of the file follow the user's umask.

    Raises:
        OutputError: the folder does not exist or cannot be written to, or the disk is full.
    """
    if not path.parent.exists():
        raise OutputError(
            f"{path}: cannot be written, because the folder {path.parent} does not exist", Remedy.CHOOSE_OUTPUT
        )
    with blame_output(path, "written", Remedy.CHOOSE_OUTPUT):
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        os.close(handle)
    aside = Path(name)
    try:
        with blame_output(path, "written", Remedy.FREE_SPACE):
            yield aside
            aside.chmod(0o666 & ~_read_umask())
            flush(aside)
            aside.replace(path)
            flush(path.parent)
    finally:
        aside.unlink(missing_ok=True)


def flush(path: Path) -> None:
    """Makes the system write a file, or the names of the files in a folder, to the disk now."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno != errno.EINVAL:  # EINVAL: the file system has nothing to flush
            raise
    finally:
        os.close(handle)


def _read_umask() -> int:
    """Returns the user's umask, which can be read only by setting another umask; the user's is set again at once."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def write_text(path: Path, text: str) -> None:
    """Writes a UTF-8 text file, completely or not at all, with control characters as escapes."""
    with write_aside(path) as aside:
        aside.write_text(show_lines(text), encoding="utf-8")


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Writes content as a JSON file (see `to_json`), completely or not at all."""
    write_text(path, to_json(content) + "\n")


def to_json(content: Mapping[str, Any]) -> str:
    """Returns the content as standard JSON text, which has no NaN or infinity; see `to_json_values`."""
    return json.dumps(to_json_values(content), indent=1, allow_nan=False)


def to_json_values(value: Any) -> Any:
    """Converts a value for JSON: NaN and infinity to None, NumPy's numbers to Python's, control characters to escapes."""
    if isinstance(value, Mapping):
        return {key: to_json_values(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_values(part) for part in value]
    if isinstance(value, str):
        return show_lines(value)
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_bytes(path: Path, content: bytes) -> None:
    """Writes bytes as a file, completely or not at all."""
    with write_aside(path) as aside:
        aside.write_bytes(content)
