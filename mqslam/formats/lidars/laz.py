"""LAS files, and LAZ ones by way of an unpacked copy: lazrs, which unpacks, can crash with the whole process."""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from mqslam.errors import DataError, untrusted
from mqslam.execution.guards.apart import ProcessFailed, call_apart

_RECORD_BYTES, _COMPRESSED = 54, 0x80  # header of a variable-length record, flag of compressed points
_ALWAYS_BYTES: Final = 1 << 30  # memory for an interpreter with its libraries; almost all of it is never used
_COPIES: Final = 4  # of the points, that unpacking and writing hold at a time


@contextmanager
def unpack(path: Path) -> Iterator[Path]:
    """Yields the path of a LAS file with the content of a LAS or LAZ one; a copy is gone after the block.

    Raises:
        DataError: the file cannot be unpacked.
    """
    compressed, points_bytes = _read_covariances(path)
    if points_bytes > untrusted.bound_unpacked(path.stat().st_size):
        raise DataError(path, f"claims {points_bytes} bytes of points in {path.stat().st_size} bytes", "write it anew")
    if not _is_plausible(path):
        raise DataError(path, "has a damaged header or chunk table", "copy it anew")
    if not compressed:
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="mqslam-") as folder:
        copy = Path(folder) / "points.las"
        try:
            words = [str(path.absolute()), str(copy)]
            call_apart(write_unpacked, words, most_bytes=_ALWAYS_BYTES + _COPIES * untrusted.bound_unpacked(points_bytes))
        except ProcessFailed as error:
            raise DataError(path, f"is not a readable {path.suffix} ({error})", "write it anew") from error
        yield copy


def write_unpacked(words: list[str]) -> bytes:
    """Writes the LAZ file of the first path as a LAS file at the second, for `call_apart`."""
    import laspy

    backend = laspy.LazBackend.Lazrs  # the parallel one aborts on damaged chunks
    with laspy.open(words[0], laz_backend=backend, read_evlrs=False) as file:
        count, cloud = file.header.point_count, file.read()
    if len(cloud.points) != count:
        raise ValueError(f"holds {len(cloud.points)} of {count} points")
    cloud.write(words[1], do_compress=False)
    return b""


def _read_covariances(path: Path) -> tuple[bool, int]:
    """Returns whether the points are compressed, and how many bytes of them the header claims."""
    with path.open("rb") as file:
        head = file.read(255).ljust(255, b"\0")
    (point_bytes, old_count), (count,) = struct.unpack_from("<HI", head, 105), struct.unpack_from("<Q", head, 247)
    is_new = head[24:26] >= b"\1\4"
    return bool(head[104] & _COMPRESSED), point_bytes * max(old_count, count if is_new else 0)


def _is_plausible(path: Path) -> bool:
    """Returns whether the file can hold the records and chunks it claims: laspy and lazrs allocate what they read."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(107).ljust(107, b"\0")
        header_size, points_at, records = struct.unpack_from("<HII", head, 94)
        if header_size + _RECORD_BYTES * records > min(points_at, size):
            return False
        if not head[104] & _COMPRESSED:
            return True
        file.seek(header_size)
        if not _are_plausible_items(file.read(points_at - header_size), records, int.from_bytes(head[105:107], "little")):
            return False
        file.seek(points_at)
        (table_at,) = struct.unpack("<q", file.read(8).ljust(8, b"\0"))
        if table_at == -1:  # written as a stream: the table's place follows it
            file.seek(max(0, size - 8))
            (table_at,) = struct.unpack("<q", file.read(8).ljust(8, b"\0"))
        if not points_at < table_at < size:
            return False
        file.seek(table_at)
        _, chunks = struct.unpack("<II", file.read(8).ljust(8, b"\xff"))
    return bool(chunks <= size)


def _are_plausible_items(block: bytes, records: int, point_bytes: int) -> bool:
    """Returns whether records of a LAZ file say how points are packed, in items that add up to a point, or lazrs panics."""
    at = 0
    for _ in range(records):
        user, number, length = struct.unpack_from("<2x16sHH", block.ljust(at + _RECORD_BYTES, b"\0"), at)
        content = block[at + _RECORD_BYTES : at + _RECORD_BYTES + length]
        at += _RECORD_BYTES + length
        if user.rstrip(b"\0") == b"laszip encoded" and number == 22204 and len(content) >= 34:
            count = int.from_bytes(content[32:34], "little")
            sizes = [int.from_bytes(content[k + 2 : k + 4], "little") for k in range(34, 34 + 6 * count, 6)]
            return count > 0 and sum(sizes) == point_bytes and len(content) >= 34 + 6 * count
    return False
