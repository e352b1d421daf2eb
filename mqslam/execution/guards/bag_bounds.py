"""Bounds on the memory that the library rosbags uses for a ROS bag; without them, rosbags takes as much as a bag asks for.

Bounded functions replace the functions by which rosbags unpacks data, opens databases, and parses profiles and message
definitions.
"""

from __future__ import annotations

import importlib
import io
import re
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, cast

from mqslam.errors.untrusted import bound_unpacked

_LONGEST_QUALITIES = 4000  # characters of quality-of-service profiles; one profile has about 300
_LONGEST_DEFINITION = 1_000_000  # characters
_LONGEST_ARRAY = 1000  # strings or messages in an array of fixed length: rosbags writes code for each
_LARGE_CONSTANT = re.compile(r"<<|\bconst\b[^;]*=[^;]*\*")  # computed constants: a few can fill the memory


@cache
def bound_rosbags() -> None:
    """Replaces functions of rosbags by bounded ones; only the first call has an effect."""
    names = "rosbag1.reader", "rosbag2.reader", "rosbag2.storage_mcap", "rosbag2.storage_sqlite3", "highlevel.anyreader"
    first, second, mcap, sqlite, reading = (cast(Any, importlib.import_module(f"rosbags.{name}")) for name in names)
    lz4, zstd = _unpack_with("lz4.frame", "LZ4FrameDecompressor"), _BoundedZstd(second.zstd)
    first.decompressors.update(bz2=_unpack_with("bz2", "BZ2Decompressor"), lz4=lz4)
    mcap.lz4_decompress, mcap.zstd, second.zstd = lz4, zstd, zstd
    second.parse_qos = mcap.parse_qos = sqlite.parse_qos = partial(_parse_qualities, second.parse_qos)
    sqlite.apsw.connection_hooks.append(partial(_bound_database, sqlite.apsw))
    reading.get_types_from_msg = _bound_definitions(reading.get_types_from_msg)
    reading.get_types_from_idl = _bound_definitions(reading.get_types_from_idl)


def _unpack_with(module: str, name: str) -> Callable[[bytes], bytes]:
    """Returns a function that unpacks data, as `_unpack` does, by the decompressor class `name` of a module."""
    return partial(_unpack, getattr(importlib.import_module(module), name))


class _BoundedZstd:
    """A bounded replacement of the zstd module, with which rosbags unpacks chunks, messages and whole files."""

    def __init__(self, zstd: Any) -> None:
        self._zstd = zstd

    def decompress(self, packed: bytes) -> bytes:
        """Unpacks a chunk or a message; raises ValueError if it unpacks to more than is allowed."""
        return _unpack(self._zstd.ZstdDecompressor, packed)

    def open(self, file: Any, mode: str) -> Any:
        """Opens a packed file for reading."""
        size = file.seek(0, io.SEEK_END)
        file.seek(0)
        return _BoundedFile(self._zstd.open(file, mode), bound_unpacked(size))


class _BoundedFile:
    """A packed file that is unpacked while it is read, to at most `most_bytes` bytes in all."""

    def __init__(self, file: Any, most_bytes: int) -> None:
        self._file, self._left, self._most = file, most_bytes, most_bytes

    def __enter__(self) -> _BoundedFile:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    def read(self, size: int = -1) -> bytes:
        """Reads `size` bytes or fewer, all if it is negative; raises ValueError if the file unpacks to too many bytes."""
        content: bytes = self._file.read(min(size, self._left + 1) if size >= 0 else self._left + 1)
        self._left -= len(content)
        if self._left < 0:
            raise _refuse(self._most)
        return content


def _unpack(make: Callable[[], Any], packed: bytes) -> bytes:
    """Unpacks one stream or several joined streams, each with a new unpacker of bz2, lz4 or zstd that `make` returns.

    Raises:
        ValueError: the streams unpack to more than is allowed, or end too early.
    """
    most, parts, left = bound_unpacked(len(packed)), [], packed
    while left:
        unpacker = make()
        parts.append(unpacker.decompress(left, max_length=most + 1))
        most -= len(parts[-1])
        if most < 0:
            raise _refuse(bound_unpacked(len(packed)))
        if not unpacker.eof:
            raise ValueError("packed data ends too early")
        left = unpacker.unused_data or b""
    return b"".join(parts) if len(parts) != 1 else parts[0]


def _refuse(most_bytes: int) -> ValueError:
    """Returns the error for packed data that unpacks to more than `most_bytes`."""
    return ValueError(f"packed data that unpacks to more than {most_bytes / 1e6:.0f} MB; write it in smaller chunks")


def _parse_qualities(parse: Callable[[Any], list[Any]], profiles: Any) -> list[Any]:
    """Parses quality-of-service profiles; returns [] for YAML that is damaged, too long, or holds references (`&`, `*`)."""
    is_short = isinstance(profiles, str) and len(profiles) <= _LONGEST_QUALITIES and not set("&*") & set(profiles)
    try:
        return parse(profiles) if is_short else []
    except Exception:  # any error may be ignored, because reading needs no profiles
        return []


def _bound_database(apsw: Any, database: Any) -> None:
    """Forbids views in a database and bounds the length of a row, so that no query returns far more than the file holds."""
    database.config(apsw.SQLITE_DBCONFIG_ENABLE_VIEW, 0)
    database.limit(apsw.SQLITE_LIMIT_LENGTH, bound_unpacked(0) + Path(database.filename).stat().st_size)


def _bound_definitions(parse: Callable[..., Mapping[str, Any]]) -> Callable[..., Mapping[str, Any]]:
    """Returns a parser of message definitions that raises ValueError if rosbags would need too much memory for them."""
    from rosbags.interfaces import Nodetype

    def parse_bounded(text: str, *name: str) -> Mapping[str, Any]:
        if len(text) > _LONGEST_DEFINITION:
            raise ValueError(f"the definition of a message is too long ({len(text)} characters)")
        if _LARGE_CONSTANT.search("".join(text.split('"')[::2])):
            raise ValueError("the definition of a message computes constants, which may fill the memory")
        types = parse(text, *name)
        for message, (_, fields) in types.items():
            for field, (kind, what) in fields:
                if kind == Nodetype.ARRAY and what[1] > _LONGEST_ARRAY and not _is_number(what[0]):
                    raise ValueError(f"{message} defines {field} as {what[1]} messages or texts, too many for the memory")
        return types

    def _is_number(node: tuple[Any, Any]) -> bool:
        return bool(node[0] == Nodetype.BASE and node[1][0] not in ("string", "wstring"))

    return parse_bounded
