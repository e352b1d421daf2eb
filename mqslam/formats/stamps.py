"""Converts stamps, as files write them, to whole microseconds."""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from typing import Any

import numpy as np
from numpy.typing import NDArray

_TOO_LARGE = "holds stamps too large for any clock"
_MOST_DIGITS = 40  # digits before the decimal point; a larger number would overflow
UNITS = {"s": Decimal(10**6), "ms": Decimal(1000), "us": Decimal(1), "ns": Decimal("0.001")}
LATEST_US = 2**62
"""Largest stamp [us] that counts as valid: no clock shows a later one, and larger numbers would overflow."""
_SECONDS = r"(s|secs?|seconds|ms|msecs?|milliseconds|us|usecs?|microseconds|ns|nsecs?|nanosecs?|nanoseconds)"
_TIME_NAME = re.compile(
    r"(?:header[._/])?(?:t|times?|time_?stamps?|stamps?|gps_?time)"
    rf"(?:[ _./]*[\[(]?{_SECONDS}[\])]?)?|(?:secs?|seconds|nsecs?|nanosecs?|nanoseconds)"
)


def time_unit(name: str) -> str | None:
    """Returns the unit, one of `UNITS`, that the name of a field or column of times states.

    The result is "" for a name of times without a unit, such as t, timestamp or GpsTime, and None for any other name.
    """
    match = _TIME_NAME.fullmatch(name.strip().lower())
    if match is None:
        return None
    unit = match[1] or (match[0] if match[0].startswith(("sec", "n")) else "")
    return {"s": "s", "m": "ms", "u": "us", "n": "ns"}.get("us" if unit == "microseconds" else unit[:1], "")


def guess_unit(largest: float) -> str:
    """Guesses the unit of stamps from a large or usual one of them: ns above 1e17, us above 1e14, ms above 1e11, else s.

    Stamps since 1970 lie at 1e9 s, 1e12 ms, 1e15 us, 1e18 ns; stamps since a recording's start are seconds.
    """
    return next((unit for unit, least in (("ns", 1e17), ("us", 1e14), ("ms", 1e11)) if largest > least), "s")


def guess_stated_unit(first: int, last: int, start_us: int, end_us: int) -> str:
    """Guesses the unit of stamps that were taken for microseconds, but lie outside a recording.

    Args:
        first: the first stamp as the file states it, a whole number of the unknown unit.
        last: the last stamp as the file states it, in the same unit.
        start_us: start of the recording [us].
        end_us: end of the recording [us].

    Returns:
        `seconds`, `milliseconds` or `nanoseconds` if in this unit the stamps cover at least half of the recording, else "".
    """
    for name, unit in (("seconds", "s"), ("milliseconds", "ms"), ("nanoseconds", "ns")):
        scale = float(UNITS[unit])
        covered_us = min((last + 1) * scale, end_us) - max((first - 1) * scale, start_us)
        if covered_us >= 0.5 * (end_us - start_us):
            return name
    return ""


def parse_stamps(words: Sequence[str], unit: str = "") -> NDArray[np.int64]:
    """Parses decimal numbers (N,) as stamps (N,) [us] in exact arithmetic; a unit of "" is guessed from their size.

    Raises:
        ValueError: a word is no finite number, or a stamp is larger than `LATEST_US`.
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
    """Returns finite numbers (N,) of any type as stamps (N,) [us], and the numbers' unit; a unit of "" is guessed.

    Raises:
        ValueError: a stamp is larger than `LATEST_US`.
    """
    largest = float(np.abs(values.astype(np.float64)).max(initial=0.0))
    unit = unit or guess_unit(largest)
    if largest * float(UNITS[unit]) > LATEST_US:
        raise ValueError(_TOO_LARGE)
    if unit in ("ns", "us") and np.issubdtype(values.dtype, np.integer):
        return (values // (1000 if unit == "ns" else 1)).astype(np.int64), unit
    return np.round(values.astype(np.float64) * float(UNITS[unit])).astype(np.int64), unit


def mark_increasing(values: Sequence[float], *, strictly: bool = True) -> NDArray[np.bool_]:
    """Returns a mask (N,) of the longest increasing subsequence of values, which leaves out stray values.

    Args:
        values: the values (N,), in any unit.
        strictly: whether each value of the subsequence must be larger than the value before; if False, both may be equal.
    """
    find = bisect_left if strictly else bisect_right
    tails: list[float] = []
    tail_rows: list[int] = []
    before: list[int] = []
    for row, value in enumerate(values):
        length = find(tails, value)
        before.append(tail_rows[length - 1] if length else -1)
        tails[length : length + 1] = [value]
        tail_rows[length : length + 1] = [row]
    mask = np.zeros(len(before), dtype=np.bool_)
    row = tail_rows[-1] if tail_rows else -1
    while row >= 0:
        mask[row] = True
        row = before[row]
    return mask
