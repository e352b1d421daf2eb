"""Arrays as long as a recording, which lie in temporary files: only the parts in use take up memory.

The files have no names and vanish with the arrays, even if the process is killed.
"""

from __future__ import annotations

import math
import mmap
import os
import tempfile
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import OutputError

_SMALL = 4_000_000  # bytes; a smaller array is kept in memory, which is faster


def make_stored(shape: tuple[int, ...], kind: type[np.generic] | np.dtype[Any] = np.float64) -> NDArray[Any]:
    """Returns an array of zeros of a shape and type; a large array lies in a temporary file.

    Raises:
        OutputError: the temporary file cannot be made, for example because the disk is full.
    """
    size = math.prod(shape) * np.dtype(kind).itemsize
    if size < _SMALL:
        return np.zeros(shape, kind)
    try:
        with tempfile.TemporaryFile() as file:
            if hasattr(os, "posix_fallocate"):  # else writing to a mapped page without room on the disk kills the process
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                file.truncate(size)
            return _map(file, size, kind).reshape(shape)
    except OSError as error:
        raise _report(error) from error


class StoredRows:
    """Rows of numbers that are appended to a temporary file one block after the other.

    Args:
        width: number of values in a row.

    Raises:
        OutputError: the temporary file cannot be made.
    """

    def __init__(self, width: int) -> None:
        self._width, self._count = width, 0
        try:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115 - `close` closes it
        except OSError as error:
            raise _report(error) from error

    def __len__(self) -> int:
        return self._count

    def append(self, rows: NDArray[np.float64]) -> None:
        """Appends rows (N, width); raises OutputError if the disk is full."""
        try:
            self._file.write(np.ascontiguousarray(rows, dtype=np.float64).data if len(rows) else b"")
        except OSError as error:
            raise _report(error) from error
        self._count += len(rows)

    def close(self) -> NDArray[np.float64]:
        """Returns all rows (M, width) as an array that lies in the file; after this, no row can be appended."""
        try:
            with self._file as file:
                file.flush()
                size = self._count * self._width * 8
                rows = _map(file, size, np.float64) if size else np.empty(0)
        except OSError as error:
            raise _report(error) from error
        return rows.reshape(-1, self._width)


def release(*parts: NDArray[Any] | memoryview | mmap.mmap) -> None:
    """Frees the memory that mapped files, or arrays in mapped files, take up until they are read again.

    Arrays that lie in no mapped file stay as they are.
    """
    for part in parts:
        base: Any = part
        while isinstance(base, np.ndarray | memoryview):
            base = base.base if isinstance(base, np.ndarray) else base.obj
        if isinstance(base, mmap.mmap) and hasattr(base, "madvise"):  # Windows has no such call
            base.madvise(mmap.MADV_DONTNEED)


def _map(file: IO[bytes], size: int, kind: type[np.generic] | np.dtype[Any]) -> NDArray[Any]:
    """Maps the first `size` bytes of a file into memory as an array (N,) of numbers of the type `kind`."""
    return np.frombuffer(mmap.mmap(file.fileno(), size), kind)


def _report(error: OSError) -> OutputError:
    """Returns the error that tells the user that temporary files cannot be written, and why."""
    folder = tempfile.gettempdir()
    return OutputError(f"{folder}: temporary files cannot be written ({error.strerror})", f"free space in {folder}")
