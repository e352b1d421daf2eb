"""Power images on disk."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError

_MOST_PIXELS = 64_000_000
_DAMAGE = (OSError, SyntaxError, ValueError, EOFError, zlib.error, struct.error)


def read_grey(path: Path) -> NDArray[np.uint8]:
    """The pixels (rows, columns) of an 8-bit grey PNG.

    Raises:
        DataError: missing, not such a PNG, damaged, or over 64 million pixels.
    """
    from PIL import Image

    remedy = "copy it anew, or leave it out of the recording"
    try:
        with Image.open(path, formats=("PNG",)) as image:
            width, height = image.size
            if image.mode != "L":
                raise DataError(path, f"is not an 8-bit grey image (mode {image.mode})", remedy)
            if width * height > _MOST_PIXELS:
                raise DataError(path, f"is too large for one revolution ({width} x {height} pixels)", remedy)
            return np.asarray(image)
    except (*_DAMAGE, Image.DecompressionBombError) as error:
        raise DataError(path, f"is not a readable PNG ({error})", remedy) from error


def stamped_names(folder: Path) -> NDArray[np.int64]:
    """What the images `<t>.png` of a folder are called, (N,) in order; images of other names do not count."""
    names = (image.stem for image in folder.glob("*.png"))
    stamps = {int(name) for name in names if name.isdecimal() and len(name) <= 19 and str(int(name)) == name}
    return np.array(sorted(stamp for stamp in stamps if stamp < 2**63), dtype=np.int64)
