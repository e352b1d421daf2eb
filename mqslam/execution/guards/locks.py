"""Locks of outputs: a file beside an output names the process that is writing the output, and keeps other processes away."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mqslam.errors import OutputError, Remedy

_TITLE = "mqslam, process"  # first words in the file of a lock; a file with other first words is not ours
_LONGEST = 10_000  # bytes of a lock that are read
_HELD = (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES)  # errors of a lock that another process holds
_TRIES = 5  # attempts, since the owner may remove the file between our opening and our locking it


class Lock:
    """The lock of an output, which this process holds.

    Args:
        path: file of the lock.
        handle: handle of the file, which is open and locked.
        found: content of the file, if the process that held the lock before was killed; else empty.

    Attributes:
        notes: lines that killed processes have added by `note`.
    """

    def __init__(self, path: Path, handle: int, found: bytes) -> None:
        self._path, self._handle, self._found = path, handle, found
        self.notes = tuple(os.fsdecode(found).splitlines()[1:])
        self._write(os.fsencode("\n".join((f"{_TITLE} {os.getpid()} on {socket.gethostname()}", *self.notes))) + b"\n")

    def note(self, line: str) -> None:
        """Adds a line to the file, for the next owner if this process is killed."""
        os.write(self._handle, os.fsencode(f"{line}\n"))

    def remove(self) -> None:
        """Removes the file of the lock."""
        with contextlib.suppress(OSError):
            self._path.unlink()

    def restore(self) -> None:
        """Restores the notes of a killed process that were found in the file; without any, removes the file."""
        if not self._found:
            self.remove()
            return
        with contextlib.suppress(OSError):
            self._write(self._found)

    def _write(self, content: bytes) -> None:
        """Replaces the content of the file by other content."""
        os.ftruncate(self._handle, 0)
        os.lseek(self._handle, 0, os.SEEK_SET)
        os.write(self._handle, content)


@contextmanager
def lock_output(out: Path) -> Iterator[Lock]:
    """Yields the lock of an output; the lock's file is removed at the end of the block.

    The system frees the lock of a process that is killed. The file stays, with the notes of that process, until a later
    block ends without an error.

    Args:
        out: the file or folder that is written; folders above it are made, and removed again if they stay empty.

    Raises:
        OutputError: another process or thread holds the lock, or the file cannot be made.
    """
    path = out.parent / f".{out.name}.lock"
    made = [folder for folder in (out.parent, *out.parent.parents) if not folder.exists()]
    try:
        with contextlib.ExitStack() as opened:
            try:
                out.parent.mkdir(parents=True, exist_ok=True)
                lock = _take(path, out, opened)
            except OSError as error:
                remedy = Remedy.FREE_SPACE if error.errno == errno.ENOSPC else Remedy.CHOOSE_OUTPUT
                raise OutputError(f"{out}: cannot be made ({error.strerror})", remedy) from error
            try:
                yield lock
            except BaseException:
                lock.restore()
                raise
            lock.remove()
    finally:
        for folder in made:
            with contextlib.suppress(OSError):
                folder.rmdir()


def _take(path: Path, out: Path, opened: contextlib.ExitStack) -> Lock:
    """Opens and locks the lock file at `path` of the output `out`; the file is closed when `opened` is closed."""
    for _ in range(_TRIES):
        handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        try:
            locked = _try_to_lock(handle)
            found = os.read(handle, _LONGEST)
            owner = os.fsdecode(found.split(b"\n")[0])
            if owner and not owner.startswith(_TITLE):
                raise OutputError(f"{path}: is not a lock of mqslam, but has the name of one", Remedy.CHOOSE_OUTPUT)
            if not locked:
                by = owner.removeprefix("mqslam, ") or "another process"
                raise OutputError(f"{out}: is being written by {by}", Remedy.WAIT_OR_CHOOSE_OUTPUT)
            if path.exists() and os.path.samestat(os.fstat(handle), path.stat()):
                opened.callback(os.close, handle)
                return Lock(path, handle, found)
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)
    raise OutputError(f"{out}: is being written by other processes", Remedy.WAIT_OR_CHOOSE_OUTPUT)


def _try_to_lock(handle: int) -> bool:
    """Locks a file; returns False if another owner holds it. On a file system without locks, returns True."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in _HELD
    return True
