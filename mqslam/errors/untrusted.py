"""Files of unknown origin: only files of bounded shape are opened, and whatever goes wrong is an error about the file."""

from __future__ import annotations

import codecs
import logging
import re
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from functools import wraps
from pathlib import Path
from typing import Concatenate, ParamSpec, Protocol, TextIO, TypeVar

from mqslam.errors import DataError, MqslamError, raise_interrupt

_ALWAYS_BYTES = 16_000_000  # whatever is packed may unpack to this size
_MOST_EXPANSION = 20  # what is larger may unpack to this many times its size: measurements hardly pack
YAML_BYTES = 300_000  # size of a text in YAML, whose parsing takes five hundred times as much memory, and seconds
_LONGEST_LINE = 1_000_000  # bytes; no table, log or listing has longer ones
_UTF_16 = re.compile(rb"\xff\xfe[\x01-\x7f]\0|\xfe\xff\0[\x01-\x7f]")  # the mark, and a first character that is ASCII
_DAMAGED = "copy it anew, or leave it out"
_KINDS = {
    stat.S_ISFIFO: "a pipe",
    stat.S_ISSOCK: "a socket",
    stat.S_ISCHR: "a device",
    stat.S_ISBLK: "a device",
}
_log = logging.getLogger(__name__)
_folder: ContextVar[Path | None] = ContextVar("folder", default=None)
P = ParamSpec("P")
R = TypeVar("R", bound="_Recording")
T = TypeVar("T")


class _Recording(Protocol):
    @property
    def path(self) -> Path:
        """Where the recording lies."""


def bound_unpacked(packed_bytes: int) -> int:
    """Returns to how many bytes at most something packed may unpack."""
    return _ALWAYS_BYTES + _MOST_EXPANSION * packed_bytes


def check_file(path: Path) -> Path:
    """Returns the path of a file if it may be opened; what opens it says so if it is not there or a folder.

    Raises:
        DataError: it is a pipe, a socket or a device, or a link out of the folder that is being read.
    """
    folder = _folder.get()
    if folder is not None and path.is_symlink():
        above = path.parent.resolve()
        if path.absolute().is_relative_to(folder) or above.is_relative_to(folder.resolve()):
            check_link(path, folder.resolve(), above)
    try:
        mode = path.stat().st_mode
    except OSError:
        return path
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        kind = next((kind for is_kind, kind in _KINDS.items() if is_kind(mode)), "no regular file")
        raise DataError(path, f"is {kind}, not a file", "copy its content into a file")
    return path


def check_link(path: Path, *inside: Path) -> None:
    """Checks that a link leads nowhere but below one of some folders.

    Raises:
        DataError: it leads out of it.
    """
    target = path.resolve()
    if not any(target.is_relative_to(folder) for folder in inside):
        raise DataError(path, f"is a link out of the recording (to {target})", "copy the file in its place")


@contextmanager
def stay_within(folder: Path) -> Iterator[None]:
    """Refuses files of a folder that are links out of it, while the block lasts; files that are elsewhere do not count."""
    before = _folder.set(folder.absolute())
    try:
        yield
    finally:
        _folder.reset(before)


def open_text(path: Path, encoding: str = "utf-8", errors: str | None = None) -> TextIO:
    """Opens a text file whose lines are of bounded length; a byte order mark says how it is encoded, and is left out.

    Raises:
        DataError: it is no file, or has a line that is too long.
        OSError: it cannot be opened.
    """
    _check_lines(check_file(path))
    with path.open("rb") as file:
        marked = _read_mark(file.read(4))
    return path.open(encoding=marked or encoding, errors=errors)


def decode(content: bytes) -> str:
    """Decodes a text in UTF-8, or as its byte order mark says.

    Raises:
        UnicodeDecodeError: it is in another encoding.
    """
    return content.decode(_read_mark(content) or "utf-8")


def read_text(path: Path, encoding: str = "utf-8") -> str:
    """Reads a text file whose lines are of bounded length.

    Raises:
        DataError: it is no file, or has a line that is too long.
        OSError: it cannot be read.
        UnicodeDecodeError: it is not in the encoding.
    """
    with open_text(path, encoding) as file:
        return file.read()


def read_document(path: Path, most_bytes: int = _ALWAYS_BYTES) -> str:
    """Reads a text in JSON, or in YAML with its own bound, which takes many times its size once it is parsed.

    Raises:
        DataError: it is no file, or is too large.
        OSError: it cannot be read.
        UnicodeDecodeError: it is not UTF-8.
    """
    if check_file(path).stat().st_size > most_bytes:
        raise DataError(path, f"is larger than {most_bytes / 1e6:g} MB, which nothing of its kind is", "give another one")
    return decode(path.read_bytes())


@contextmanager
def blame_file(path: Path) -> Iterator[None]:
    """Turns whatever goes wrong in the block into an error about a file; the log has its traceback.

    Raises:
        DataError: something has gone wrong.
    """
    try:
        yield
    except MqslamError:
        raise
    except MemoryError as error:
        raise DataError(path, "does not fit into the memory", _DAMAGED) from error
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror or error})", "check its permissions") from error
    except Exception as error:  # damaged files meet code of many libraries, and no list of what that raises is complete
        raise_interrupt(error)
        _log.info("%s cannot be read", path, exc_info=error)
        reason = (str(error).splitlines() or [""])[0][:160]
        what = f"{type(error).__name__}: {reason}" if reason else type(error).__name__
        raise DataError(path, f"is damaged or of another kind ({what})", _DAMAGED) from error


def reads_file(read: Callable[Concatenate[Path, P], T]) -> Callable[Concatenate[Path, P], T]:
    """Returns a function that reads the file or folder of its first argument, with all of its errors about that.

    Files of a folder must not be links out of it.
    """

    @wraps(read)
    def read_and_blame(path: Path, /, *arguments: P.args, **named: P.kwargs) -> T:
        with blame_file(path), stay_within(path) if path.is_dir() else nullcontext():
            return read(path, *arguments, **named)

    return read_and_blame


def reads_recording(read: Callable[Concatenate[R, P], Iterator[T]]) -> Callable[Concatenate[R, P], Iterator[T]]:
    """Returns a method that reads parts of a recording, with all of its errors about that recording."""

    @wraps(read)
    def read_and_blame(recording: R, /, *arguments: P.args, **named: P.kwargs) -> Iterator[T]:
        with blame_file(recording.path):
            yield from read(recording, *arguments, **named)

    return read_and_blame


def _read_mark(content: bytes) -> str | None:
    """Returns the encoding that a text's byte order mark states, or None."""
    if content.startswith(codecs.BOM_UTF8):
        return "utf-8-sig"
    return "utf-16" if _UTF_16.match(content) else None


def _check_lines(path: Path) -> None:
    """Raises DataError if a file has a line that is too long."""
    begin = 0  # bytes of the line that the block continues
    with path.open("rb") as file:
        while block := file.read(_LONGEST_LINE):
            first = block.find(b"\n")
            if begin + (first if first >= 0 else len(block)) > _LONGEST_LINE:
                raise DataError(path, f"has a line of over {_LONGEST_LINE} bytes", "give a text file, or copy it anew")
            begin = begin + len(block) if first < 0 else len(block) - 1 - block.rfind(b"\n")
