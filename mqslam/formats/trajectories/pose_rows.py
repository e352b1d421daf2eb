"""Lines of text that hold a pose each, and the numbers and stamps in them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError, find_near, untrusted
from mqslam.formats.shared.stamps import parse_stamps

KNOWN = "give TUM, KITTI with a file of times, a CSV whose header names t, x, y and yaw or qx, qy, qz, qw, or a bag"


def read_rows(path: Path) -> list[str]:
    """Reads the lines of a text file that are not blank.

    Raises:
        DataError: the file does not exist or is no text.
    """
    try:
        return [line.strip() for line in untrusted.read_text(path, "utf-8-sig").splitlines() if line.strip()]
    except FileNotFoundError as error:
        beside = [other.name for other in path.parent.iterdir()] if path.parent.is_dir() else []
        near = find_near(path.name, beside)
        raise DataError(path, "does not exist", f"did you mean {near}?" if near else "check the path") from error
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8"
        raise DataError(path, f"is not a readable text file ({reason})", KNOWN) from error


def parse_numbers(path: Path, rows: Sequence[Sequence[str]], columns: Sequence[int]) -> NDArray[np.float64]:
    """Parses columns (N, len(columns)) of rows of words.

    Raises:
        DataError: one of them is not a finite number.
    """
    table = np.empty((len(rows), len(columns)))
    for row, words in enumerate(rows):
        try:
            table[row] = [float(words[column]) for column in columns]
        except (ValueError, IndexError):
            table[row] = np.nan
    if not np.isfinite(table).all():
        row = int(np.argmin(np.isfinite(table).all(axis=1)))
        raise DataError(path, f"pose {row + 1} is not made of finite numbers", "repair or remove its line")
    return table


def parse_times(path: Path, words: Sequence[str], unit: str = "") -> NDArray[np.int64]:
    """Parses words as stamps (N,) [us] in a unit; "" guesses it from their size.

    Raises:
        DataError: one of them is no stamp.
    """
    try:
        return parse_stamps(words, unit)
    except ValueError as error:
        raise DataError(path, str(error), "give stamps in s, us or ns") from error
