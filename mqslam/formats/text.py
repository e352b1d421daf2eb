"""Reads text files; every failure to read a file becomes a DataError that names the file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from mqslam.errors import DataError, find_near, untrusted


@contextmanager
def open_lines(path: Path, remedy: str, errors: str | None = None, missing: str = "") -> Iterator[TextIO]:
    """Opens a text file; any failure to read the file before the block ends becomes a DataError that names the file.

    Args:
        path: the file.
        remedy: advice for the error if the file is no text, such as which file to give instead.
        errors: how bytes that are not UTF-8 are decoded, as for `open`; None refuses them.
        missing: advice for the error if the file does not exist; "" suggests a file with a similar name if there is one.

    Raises:
        DataError: the file does not exist, cannot be read, or is no text.
    """
    try:
        with untrusted.open_text(path, errors) as file:
            yield file
    except FileNotFoundError as error:
        near = find_near(path.name, [other.name for other in path.parent.iterdir()] if path.parent.is_dir() else [])
        named = f"did you mean {near}?" if near else "check the path"
        raise DataError(path, "does not exist", missing or named) from error
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8"
        raise DataError(path, f"is not a readable text file ({reason})", remedy) from error


def read_text(path: Path, remedy: str, missing: str = "") -> str:
    """Reads a text file; errors advise `remedy` if the file is no text, and `missing` (see `open_lines`) if it is missing.

    Raises:
        DataError: the file does not exist, cannot be read, or is no text.
    """
    with open_lines(path, remedy, missing=missing) as file:
        return file.read()


def read_lines(path: Path, remedy: str, missing: str = "") -> list[str]:
    """Reads the lines of a text file as `read_text` does, blank lines included, without the white space around them.

    Raises:
        DataError: the file does not exist, cannot be read, or is no text.
    """
    return [line.strip() for line in read_text(path, remedy, missing).splitlines()]
