"""Reads and writes images of polar scans: 8-bit grey PNG files, and PNGs or JPEGs in messages."""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mqslam.core.wording import is_or_are
from mqslam.errors import DataError, untrusted

_MOST_PIXELS, _LONGEST_SIDE = 16_000_000, 65_535  # a larger image is damaged, or an attempt to fill the memory
_MOST_EXPANSION = 1032  # deflate packs at most this many pixels into a byte: a file that states more was cut off
CONVERT_IMAGES = "convert the images to 8-bit grey (mono8)"
_Read = TypeVar("_Read")
_DAMAGE = (OSError, SyntaxError, ValueError, EOFError, zlib.error, struct.error)


class NotGreyError(ValueError):
    """Raised for an image that is not 8-bit grey."""


def read_grey(path: Path) -> NDArray[np.uint8]:
    """Reads the pixels (rows, columns) of an 8-bit grey PNG.

    Raises:
        DataError: the file is missing, is no such PNG, is damaged or too large for a polar scan.
    """
    try:
        return decode_grey(path, ("PNG",))
    except NotGreyError as error:
        raise DataError(path, str(error), CONVERT_IMAGES) from error
    except ValueError as error:
        raise DataError(path, str(error), "copy the file again, or leave it out of the recording") from error


def decode_grey(source: Path | bytes, formats: tuple[str, ...]) -> NDArray[np.uint8]:
    """Decodes the pixels (rows, columns) of an 8-bit grey image in one of the given formats, by Pillow's names.

    The source is the image's file, or the content of such a file.

    Raises:
        NotGreyError: the image is not 8-bit grey.
        ValueError: the image is missing, in none of the formats, damaged, or too large for a polar scan.
    """
    from PIL import Image

    try:
        size = len(source) if isinstance(source, bytes) else untrusted.check_file(source).stat().st_size
        with Image.open(io.BytesIO(source) if isinstance(source, bytes) else source, formats=formats) as image:
            width, height = image.size
            too_large, mode = describe_excess(height, width), image.mode
            if mode == "L" and not too_large:
                if width * height > _MOST_EXPANSION * size:
                    raise ValueError("image file is truncated")
                return np.asarray(image)
    except (*_DAMAGE, Image.DecompressionBombError) as error:
        raise ValueError(f"is not a readable {' or '.join(formats)} ({error})") from error
    if too_large:
        raise ValueError(too_large)
    raise NotGreyError(f"is not an 8-bit grey image (mode {mode})")


def describe_excess(height: int, width: int) -> str:
    """Describes, for an error, that an image of a size [pixels] is too large for a polar scan; returns "" if it is not.

    It is too large if it has over 16 million pixels, or a side of over 65,535 pixels.
    """
    is_too_large = height * width > _MOST_PIXELS or max(height, width) > _LONGEST_SIDE
    return f"is too large for one polar scan ({width} x {height} pixels)" if is_too_large else ""


def list_stamps(folder: Path) -> NDArray[np.int64]:
    """Lists the stamps t (N,), in any unit, of the images `<t>.png` in a folder in increasing order; ignores other files.

    Raises:
        DataError: an image is a link that `list_numbers` refuses.
    """
    names = (name for name in list_numbers(folder) if len(name) <= 19 and str(int(name)) == name)
    return np.array(sorted(stamp for stamp in map(int, names) if stamp < 2**63), dtype=np.int64)


def list_numbers(folder: Path) -> Iterator[str]:
    """Yields, in any order and without `.png`, the names of the images in a folder that are made of decimal digits.

    Raises:
        DataError: an image is a link to a file outside the folder's parent folder, and so maybe outside the recording.
    """
    inside = folder.resolve().parent
    with os.scandir(folder) as entries:
        for entry in entries:
            stem = entry.name.removesuffix(".png")
            if stem == entry.name or not (stem.isascii() and stem.isdecimal()):
                continue
            if entry.is_symlink():
                untrusted.check_link(Path(entry.path), inside)
            yield stem


def read_first(names: Sequence[int], read: Callable[[int], _Read], place: str) -> tuple[_Read, int, list[str]]:
    """Reads the first image that can be read.

    Args:
        names: names of the images, at least one, in the order in which they are tried.
        read: reads the image of a name, or raises a DataError.
        place: "first" if the names begin at the start of the recording, "last" if they begin at its end; for the fault.

    Returns:
        The result of `read` for the image, the number of images before it that could not be read, and a list with a fault
        for the user if there are such images.

    Raises:
        DataError: none of the first half of the images could be read.
    """
    errors: list[DataError] = []
    for name in names:
        try:
            content = read(name)
            break
        except DataError as error:
            errors.append(error)
        if 2 * len(errors) > len(names) - 1:
            first = errors[0]
            several = f"; at least {len(errors)} of {len(names)} polar scans cannot be used" if errors[1:] else ""
            raise DataError(first.path, f"{first.problem}{several}", first.remedy)
    if not errors:
        return content, 0, []
    several = f"{place} polar scan" if len(errors) == 1 else f"{place} {len(errors)} polar scans"
    fault = f"the {several} could not be read and {is_or_are(len(errors))} left out: {errors[0].path}: {errors[0].problem}"
    return content, len(errors), [fault]


def write_png(path: Path, image: NDArray[np.uint8]) -> None:
    """Writes pixels (rows, columns) as an 8-bit grey PNG.

    The lowest compression level is many times faster than the usual level, and the files are hardly larger.
    """
    from PIL import Image

    Image.fromarray(image).save(path, compress_level=1)
