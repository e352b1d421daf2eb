"""Stamps as files write them, brought to whole microseconds."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError, untrusted

_TOO_LARGE = "holds stamps too large for any clock"
_MOST_DIGITS = 40  # before the point; a larger number would overflow
UNITS = {"s": Decimal(10**6), "ms": Decimal(1000), "us": Decimal(1), "ns": Decimal("0.001")}
LATEST_US = 2**62
"""Stamps beyond this [us] are beyond any clock: they are damaged, and would overflow."""
FRAME_DIGITS = 6
"""Least number of digits of the number of a frame, in a list of when frames arrived and in the name of its file."""
_FRAME = re.compile(r"\s*Frame:\s*(\d{1,18})\s+Time:\s*(\d+)(?:\.(\d+))?\s*")
_NANOSECONDS = 9  # digits of a fraction of a second
_SECONDS = r"(s|secs?|seconds|ms|msecs?|milliseconds|us|usecs?|microseconds|ns|nsecs?|nanosecs?|nanoseconds)"
_TIME_NAME = re.compile(
    r"(?:header[._/])?(?:t|times?|time_?stamps?|stamps?|gps_?time)"
    rf"(?:[ _./]*[\[(]?{_SECONDS}[\])]?)?|(?:secs?|seconds|nsecs?|nanosecs?|nanoseconds)"
)


def time_unit(name: str) -> str | None:
    """Returns the unit that the name of a field or column of times states.

    It is "" where a name such as t, timestamp or GpsTime states none, and None for names of anything but times.
    """
    match = _TIME_NAME.fullmatch(name.strip().lower())
    if match is None:
        return None
    unit = match[1] or (match[0] if match[0].startswith(("sec", "n")) else "")
    return {"s": "s", "m": "ms", "u": "us", "n": "ns"}.get("us" if unit == "microseconds" else unit[:1], "")


def guess_unit(largest: float) -> str:
    """Guesses the unit of stamps from their largest magnitude: ns above 1e17, us above 1e14, ms above 1e11, else s.

    Stamps since 1970 lie at 1e9 s, 1e12 ms, 1e15 us, 1e18 ns; stamps since a recording's start are seconds.
    """
    return next((unit for unit, least in (("ns", 1e17), ("us", 1e14), ("ms", 1e11)) if largest > least), "s")


def guess_stated_unit(first: int, last: int, start_us: int, end_us: int) -> str:
    """Guesses the unit of stamps that were taken for microseconds, but lie outside a recording.

    Args:
        first: the first stamp, as the file states it, to a whole unit.
        last: the last stamp.
        start_us: start of the recording [us].
        end_us: end of the recording [us].

    Returns:
        `seconds`, `milliseconds` or `nanoseconds` if in this unit they cover at least half of the recording, else "".
    """
    for name, unit in (("seconds", "s"), ("milliseconds", "ms"), ("nanoseconds", "ns")):
        scale = float(UNITS[unit])
        covered_us = min((last + 1) * scale, end_us) - max((first - 1) * scale, start_us)
        if covered_us >= 0.5 * (end_us - start_us):
            return name
    return ""


def parse_stamps(words: Sequence[str], unit: str = "") -> NDArray[np.int64]:
    """Parses decimal numbers as stamps (N,) [us], exactly.

    Args:
        words: (N,) the numbers.
        unit: one of `UNITS`; "" guesses it from their size.

    Raises:
        ValueError: a word is no finite number, or a stamp lies beyond any clock.
    """
    try:
        values = [Decimal(word) for word in words]
    except InvalidOperation:
        raise ValueError("holds stamps that are no numbers") from None
    if not all(value.is_finite() for value in values):
        raise ValueError("holds stamps that are not finite")
    if any(value.adjusted() > _MOST_DIGITS for value in values):
        raise ValueError(_TOO_LARGE)
    scale = UNITS[unit or guess_unit(float(max(map(abs, values), default=Decimal(0))))]
    if any(abs(value) * scale > LATEST_US for value in values):
        raise ValueError(_TOO_LARGE)
    return np.array([int((value * scale).to_integral_value()) for value in values], dtype=np.int64)


def convert_stamps(values: NDArray[Any], unit: str = "") -> tuple[NDArray[np.int64], str]:
    """Converts finite numbers (N,) of any type to stamps (N,) [us], and returns their unit, guessed where none is given.

    Raises:
        ValueError: a stamp lies beyond any clock.
    """
    largest = float(np.abs(values.astype(np.float64)).max(initial=0.0))
    unit = unit or guess_unit(largest)
    if largest * float(UNITS[unit]) > LATEST_US:
        raise ValueError(_TOO_LARGE)
    if unit == "ns" and np.issubdtype(values.dtype, np.integer):
        return (values // 1000).astype(np.int64), unit
    if unit == "us" and np.issubdtype(values.dtype, np.integer):
        return values.astype(np.int64), unit
    return np.round(values.astype(np.float64) * float(UNITS[unit])).astype(np.int64), unit


def mark_increasing(stamps_us: Sequence[int]) -> NDArray[np.bool_]:
    """Marks (N,) the longest subsequence of stamps that strictly increases: one stray stamp costs one entry."""
    tails: list[int] = []
    tail_rows: list[int] = []
    before: list[int] = []
    for row, stamp in enumerate(stamps_us):
        length = bisect_left(tails, stamp)
        before.append(tail_rows[length - 1] if length else -1)
        tails[length : length + 1] = [stamp]
        tail_rows[length : length + 1] = [row]
    mask = np.zeros(len(before), dtype=np.bool_)
    row = tail_rows[-1] if tail_rows else -1
    while row >= 0:
        mask[row] = True
        row = before[row]
    return mask


def format_frame(frame: int) -> str:
    """Formats the number of a frame as the name of its file."""
    return str(frame).zfill(FRAME_DIGITS)


def read_listing(listing: Path) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Reads frames (N,) and when they arrived (N,) [us] from lines `Frame: 000001 Time: 1574859771.744660272`.

    RADIATE's files state the nanoseconds behind the point without their leading zeros: `36.25327499` is 36 s and 25,327,499
    ns, not 36.25 s. Where fractions differ in length, they are read in the way in which the frames follow more steadily.

    Raises:
        DataError: it cannot be read, or a line is of another form.
    """
    remedy = "it should hold a line 'Frame: 000001 Time: 1574859771.744660272' for each file"
    try:
        lines = [line for line in untrusted.read_text(listing).splitlines() if line.strip()]
    except FileNotFoundError as error:
        raise DataError(listing, "does not exist", remedy) from error
    except (OSError, ValueError) as error:
        raise DataError(listing, "is not a readable text file", remedy) from error
    if not lines:
        raise DataError(listing, "is empty", remedy)
    matches = [_FRAME.fullmatch(line) for line in lines]
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
