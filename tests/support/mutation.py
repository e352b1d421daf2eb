"""Damage to small valid files: bytes flipped, cut, inserted, repeated, numbers replaced; also under what is compressed."""

from __future__ import annotations

import gzip
import io
import re
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st
from PIL import Image

_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORDS = (
    b"nan",
    b"-inf",
    b"1e308",
    b"-1e-308",
    b"0",
    b"-1",
    b"9" * 40,
    b"-" + b"9" * 19,
    b"9223372036854775807",
    b"1" * 5000,
    b"",
    b"x",
    b"0x10",
    b"1_0",
    "\u0661".encode(),
    b"1,2",
    b"1 2",
    b"1\n2",
    b"1e18",
    b"4294967296",
    b"!!python/none",
)
_EXTREMES = (0, 1, -1, 2**7, 2**15, 2**31 - 1, 2**31, 2**32 - 1, 2**62, -(2**31), -(2**63), 2**63 - 1)
KINDS = ("flip", "byte", "extreme", "cut", "end", "insert", "repeat", "swap", "number")
Mutate = Callable[[bytes, "Change"], bytes]


@dataclass(frozen=True)
class Change:
    """One act of damage."""

    kind: str  # which
    which: int  # of several files or members, as a number to be taken modulo their count
    where: float  # in the content, 0 its beginning and 1 its end
    value: int  # what else the kind needs


CHANGES = st.lists(
    st.builds(
        Change,
        kind=st.sampled_from(KINDS),
        which=st.integers(0, 63),
        where=st.floats(0.0, 1.0, exclude_max=True),
        value=st.integers(0, 2**16 - 1),
    ),
    min_size=1,
    max_size=4,
)


def plain(content: bytes, change: Change) -> bytes:
    """Damages a file as it lies on the disk."""
    at, value = int(change.where * len(content)), change.value
    length = 1 + value % 64
    match change.kind:
        case "flip" if content:
            return content[:at] + bytes([content[at] ^ (1 << value % 8)]) + content[at + 1 :]
        case "byte" if content:
            return content[:at] + bytes([value % 256]) + content[at + 1 :]
        case "extreme":
            form, number = "<bhiq"[1 + value % 4], _EXTREMES[value // 4 % len(_EXTREMES)]
            size = struct.calcsize(form)
            packed = (number % 256**size).to_bytes(size, "little" if value & 1024 else "big")
            return content[:at] + packed + content[at + size :]
        case "cut":
            return content[:at] + content[at + length :]
        case "end":
            return content[:at]
        case "insert":
            return content[:at] + np.random.default_rng(value).bytes(length) + content[at:]
        case "repeat":
            return content[: at + length] + content[at : at + length] * (1 + value % 3) + content[at + length :]
        case "swap":
            other = value % max(len(content), 1)
            a, b = sorted((at, other))
            between, rest = content[a + length : b], content[b + length :]
            return content[:a] + content[b : b + length] + between + content[a : a + length] + rest
        case "number":
            numbers = list(_NUMBER.finditer(content))
            if numbers:
                result = numbers[int(change.where * len(numbers))]
                return content[: result.start()] + _WORDS[value % len(_WORDS)] + content[result.end() :]
    return content


def inside_png(content: bytes, change: Change) -> bytes:
    """Damages the pixels of an image and its shape, and packs it as a faultless PNG again."""
    with Image.open(io.BytesIO(content)) as image:
        pixels = np.asarray(image)
    height, width = pixels.shape
    raw = plain(struct.pack("<HH", height, width) + pixels.tobytes(), change)
    height, width = struct.unpack("<HH", raw[:4].ljust(4, b"\1"))
    height, width = 1 + height % 512, 1 + width % 2048
    packed = io.BytesIO()
    body = raw[4:].ljust(height * width, b"\0")[: height * width]
    Image.fromarray(np.frombuffer(body, np.uint8).reshape(height, width)).save(packed, "PNG")
    return packed.getvalue()


def inside_zip(content: bytes, change: Change) -> bytes:
    """Damages a member of an archive, and packs it with a right checksum again."""
    packed = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as before, zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as after:
        names = before.namelist()
        for name in names:
            member = before.read(name)
            after.writestr(name, plain(member, change) if name == names[change.which % len(names)] else member)
    return packed.getvalue()


def inside_gzip(content: bytes, change: Change) -> bytes:
    """Damages what is compressed, and packs it with a right checksum again."""
    return gzip.compress(plain(gzip.decompress(content), change), 1)
