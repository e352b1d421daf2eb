"""Opens files of unknown origin: checks their kind and size, and turns every failure into an error that names the file."""

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
from typing import Concatenate, ParamSpec, TextIO, TypeVar

from mqslam.errors import DataError, MqslamError, raise_interrupt

_ALWAYS_BYTES = 16_000_000  # compressed data of any size may unpack to this many bytes
_MOST_EXPANSION = 20  # plus this many times the packed size, since measurements can hardly be compressed
YAML_BYTES = 300_000  # largest YAML text, since parsing it takes seconds and five hundred times its size in memory
RESULT_BYTES = 500_000_000  # largest JSON of a result; audit.json of a day of driving has about 100 MB
_LONGEST_LINE = 1_000_000  # bytes; no table, log or listing has longer lines
_UTF_16 = re.compile(rb"\xff\xfe[\x01-\x7f]\0|\xfe\xff\0[\x01-\x7f]")  # byte order mark, then an ASCII character
_DAMAGED = "copy the file again, or leave it out"
_KINDS = {
    stat.S_ISFIFO: "a pipe",
    stat.S_ISSOCK: "a socket",
    stat.S_ISCHR: "a device",
    stat.S_ISBLK: "a device",
}
_log = logging.getLogger(__name__)
_folder: ContextVar[Path | None] = ContextVar("folder", default=None)
P = ParamSpec("P")
T = TypeVar("T")


def bound_unpacked(packed_bytes: int) -> int:
    """Returns the largest number of bytes to which `packed_bytes` bytes of compressed data may unpack."""
    return _ALWAYS_BYTES + _MOST_EXPANSION * packed_bytes


def check_file(path: Path) -> Path:
    """Returns the path of a file if it may be opened. A missing file or a folder passes: opening it raises an error.

    Raises:
        DataError: the path is a pipe, a socket or a device, or a link that leads out of the folder that is being read.
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
        kind = next((kind for is_kind, kind in _KINDS.items() if is_kind(mode)), "of an unknown kind")
        raise DataError(path, f"is {kind}, not a file", "copy its content into a file")
    return path


def check_link(path: Path, *inside: Path) -> None:
    """Checks that a link leads to a file or folder inside one of the given folders.

    Raises:
        DataError: the link leads out of all these folders.
    """
    target = path.resolve()
    if not any(target.is_relative_to(folder) for folder in inside):
        raise DataError(path, f"is a link out of the recording (to {target})", "replace the link by a copy of the file")


@contextmanager
def stay_within(folder: Path) -> Iterator[None]:
    """Makes `check_file` refuse links that lie in a folder and lead out of this folder, until the `with` block ends."""
    before = _folder.set(folder.absolute())
    try:
        yield
    finally:
        _folder.reset(before)


def open_text(path: Path, errors: str | None = None) -> TextIO:
    """Opens a text file whose lines are of bounded length, in UTF-8 or in the encoding that its byte order mark states.

    Args:
        path: the file.
        errors: how bytes that are not in the encoding are decoded, as for `open`; None raises an error when they are read.

    Raises:
        DataError: the path is not a regular file, or the file has a line that is too long.
        OSError: the file cannot be opened.
    """
    _check_lines(check_file(path))
    with path.open("rb") as file:
        marked = _read_mark(file.read(4))
    return path.open(encoding=marked or "utf-8", errors=errors)


def decode(content: bytes) -> str:
    """Decodes a text in UTF-8, or in the encoding that its byte order mark states.

    Raises:
        UnicodeDecodeError: the text is in another encoding.
    """
    return content.decode(_read_mark(content) or "utf-8")


def read_document(path: Path, most_bytes: int = _ALWAYS_BYTES) -> str:
    """Reads the text of a JSON or YAML file whose size is bounded.

    Args:
        path: the file.
        most_bytes: largest size of the file [bytes]: `YAML_BYTES` for YAML, `RESULT_BYTES` for the JSON of a result.

    Raises:
        DataError: the path is not a regular file, or the file is too large.
        OSError: the file cannot be read.
        UnicodeDecodeError: the text is neither in UTF-8 nor in the encoding of its byte order mark.
    """
    if check_file(path).stat().st_size > most_bytes:
        raise DataError(path, f"is larger than {most_bytes / 1e6:g} MB, too large for its kind", "give another file")
    return decode(path.read_bytes())


@contextmanager
def blame_file(path: Path) -> Iterator[None]:
    """Turns errors of the `with` block into a DataError about a file; the log gets the traceback of an unforeseen error.

    Errors of mqslam, interrupts and broken pipes stay as they are.

    Raises:
        DataError: the block has failed with any other error.
    """
    try:
        yield
    except (MqslamError, BrokenPipeError):  # a broken pipe is a fault of the output, not of the file
        raise
    except MemoryError as error:
        raise DataError(path, "does not fit into the memory", _DAMAGED) from error
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror or error})", "check its permissions") from error
    except Exception as error:  # damaged files reach many libraries, and no list of the errors they raise is complete
        raise_interrupt(error)
        _log.info("%s cannot be read", path, exc_info=error)
        reason = (str(error).splitlines() or [""])[0][:160]
        what = f"{type(error).__name__}: {reason}" if reason else type(error).__name__
        raise DataError(path, f"is damaged or of another kind ({what})", _DAMAGED) from error


def reads_file(read: Callable[Concatenate[Path, P], T]) -> Callable[Concatenate[Path, P], T]:
    """Decorates a function whose first argument is the path that it reads, so that each call runs inside `blame_file`.

    If the path is a folder, links that lie in the folder and lead out of it are refused.
    """

    @wraps(read)
    def read_and_blame(path: Path, /, *arguments: P.args, **named: P.kwargs) -> T:
        with blame_file(path), stay_within(path) if path.is_dir() else nullcontext():
            return read(path, *arguments, **named)

    return read_and_blame


def _read_mark(content: bytes) -> str | None:
    """Returns the encoding that the byte order mark at the start of `content` states; None without such a mark."""
    if content.startswith(codecs.BOM_UTF8):
        return "utf-8-sig"
    return "utf-16" if _UTF_16.match(content) else None


def _check_lines(path: Path) -> None:
    """Raises DataError if a file has a line of more than `_LONGEST_LINE` bytes."""
    begin = 0  # number of bytes, in the blocks before, of the line that goes on in the next block
    with path.open("rb") as file:
        while block := file.read(_LONGEST_LINE):
            first = block.find(b"\n")
            if begin + (first if first >= 0 else len(block)) > _LONGEST_LINE:
                raise DataError(
                    path, f"has a line of over {_LONGEST_LINE} bytes", "give a text file, or copy the file again"
                )
            begin = begin + len(block) if first < 0 else len(block) - 1 - block.rfind(b"\n")
