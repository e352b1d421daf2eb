"""Lists of numbered files and when they arrived, as RADIATE has them: `Frame: 000001 Time: 1574859771.744660272`."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError
from mqslam.formats.shared.stamps import parse_stamps

DIGITS = 6
"""Least number of digits of a file's name."""
_LINE = re.compile(r"\s*Frame:\s*(\d{1,18})\s+Time:\s*(\d+)(?:\.(\d+))?\s*")
_NANOSECONDS = 9  # digits of a fraction of a second


def read_listing(listing: Path) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Reads frames (N,) and when they arrived (N,) [us].

    RADIATE's files state the nanoseconds behind the point without their leading zeros: `36.25327499` is 36 s and 25,327,499
    ns, not 36.25 s. Where fractions differ in length, they are read in the way in which the frames follow more steadily.

    Raises:
        DataError: it cannot be read, or a line is of another form.
    """
    try:
        lines = [line for line in listing.read_text(encoding="utf-8").splitlines() if line.strip()]
    except (OSError, ValueError) as error:
        raise DataError(listing, "is not a readable text file", "it holds the stamps of the files") from error
    matches = [_LINE.fullmatch(line) for line in lines]
    if None in matches:
        number = matches.index(None) + 1
        raise DataError(listing, f"line {number} is not 'Frame: 000001 Time: 1574859771.744660272'", "repair it")
    rows = [match.groups(default="0") for match in matches if match]
    fractions = [fraction for _, _, fraction in rows]
    padded = [fraction.rjust(_NANOSECONDS, "0") for fraction in fractions]
    choices = [fractions] if len({len(fraction) for fraction in fractions}) == 1 else [fractions, padded]
    try:
        stamps = [
            parse_stamps([f"{second}.{fraction}" for (_, second, _), fraction in zip(rows, choice, strict=True)], "s")
            for choice in choices
        ]
    except ValueError as error:
        raise DataError(listing, str(error), "repair it") from error
    frames = np.array([int(frame) for frame, _, _ in rows], dtype=np.int64)
    return frames, min(stamps, key=_measure_unsteadiness, default=np.empty(0, dtype=np.int64))


def _measure_unsteadiness(stamps_us: NDArray[np.int64]) -> float:
    """Measures by how much successive steps between stamps (N,) differ in all."""
    return float(np.abs(np.diff(stamps_us.astype(np.float64), 2)).sum())
