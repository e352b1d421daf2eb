"""Power images on disk."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import BinaryIO, TypeVar

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError

_MOST_PIXELS = 64_000_000
_MOST_EXPANSION = 1032  # of deflate: an image that claims more pixels per byte of its file is cut short
_Read = TypeVar("_Read")
_DAMAGE = (OSError, SyntaxError, ValueError, EOFError, zlib.error, struct.error)


def read_grey(path: Path) -> NDArray[np.uint8]:
    """The pixels (rows, columns) of an 8-bit grey PNG.

    Raises:
        DataError: missing, not such a PNG, damaged, or over 64 million pixels.
    """
    try:
        return decode_grey(path, ("PNG",))
    except ValueError as error:
        raise DataError(path, str(error), "copy it anew, or leave it out of the recording") from error


def decode_grey(source: Path | BinaryIO, formats: tuple[str, ...]) -> NDArray[np.uint8]:
    """The pixels (rows, columns) of an 8-bit grey image in one of Pillow's formats.

    Raises:
        ValueError: missing, in none of the formats, not 8-bit grey, damaged, or over 64 million pixels.
    """
    from PIL import Image

    try:
        size = _size(source)
        with Image.open(source, formats=formats) as image:
            width, height = image.size
            fits = width * height <= _MOST_PIXELS
            if image.mode == "L" and fits:
                if width * height > _MOST_EXPANSION * size:
                    raise ValueError("image file is truncated")
                return np.asarray(image)
    except (*_DAMAGE, Image.DecompressionBombError) as error:
        raise ValueError(f"is not a readable {' or '.join(formats)} ({error})") from error
    if fits:
        raise ValueError(f"is not an 8-bit grey image (mode {image.mode})")
    raise ValueError(f"is too large for one revolution ({width} x {height} pixels)")


def stamped_names(folder: Path) -> NDArray[np.int64]:
    """What the images `<t>.png` of a folder are called, (N,) in order; images of other names do not count."""
    names = (name for name in numbered_names(folder) if len(name) <= 19 and str(int(name)) == name)
    return np.array(sorted(stamp for stamp in map(int, names) if stamp < 2**63), dtype=np.int64)


def numbered_names(folder: Path) -> Iterator[str]:
    """The images of a folder whose names are decimal digits, without `.png`, in any order.

    Raises:
        DataError: one is a link to somewhere that is not beside the folder or below: images come from the recording alone.
    """
    inside = folder.resolve().parent
    with os.scandir(folder) as entries:
        for entry in entries:
            stem = entry.name.removesuffix(".png")
            if stem == entry.name or not (stem.isascii() and stem.isdecimal()):
                continue
            if entry.is_symlink() and not (target := Path(entry.path).resolve()).is_relative_to(inside):
                raise DataError(entry.path, f"is a link out of the recording (to {target})", "copy the image in its place")
            yield stem


def first_readable(names: Sequence[int], read: Callable[[int], _Read], place: str) -> tuple[_Read, int, list[str]]:
    """What the first image is that can be read, how many before it cannot, and a fault where some cannot.

    Args:
        names: of images, in the order in which they are tried.
        read: reads the image of a name, or raises a DataError.
        place: what the first of the names is in the recording: first or last.

    Raises:
        DataError: half of the images cannot be read.
    """
    errors: list[DataError] = []
    while True:
        try:
            found = read(names[len(errors)])
            break
        except DataError as error:
            errors.append(error)
            if 2 * len(errors) > len(names) - 1:
                raise errors[0] from None
    several = f"{place} revolution" if len(errors) == 1 else f"{place} {len(errors)} revolutions"
    faults = [f"the {several} could not be read, left out: {errors[0].path}: {errors[0].problem}"] if errors else []
    return found, len(errors), faults


def _size(source: Path | BinaryIO) -> int:
    """Bytes of a file; one that is open is left at its beginning."""
    if isinstance(source, Path):
        return source.stat().st_size
    size = source.seek(0, os.SEEK_END)
    source.seek(0)
    return size
