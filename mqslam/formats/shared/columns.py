"""Columns of tables by their names, which may state a unit: it is converted, or the column is refused by its name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError
from mqslam.formats.shared.stamps import parse_stamps, time_unit

METRES: Final = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "dm": 0.1, "km": 1e3, "ft": 0.3048, "meters": 1.0, "metres": 1.0}
DEGREES: Final = {"deg": 1.0, "degrees": 1.0, "degree": 1.0, "°": 1.0, "rad": 180.0 / np.pi, "radians": 180.0 / np.pi}
RADIANS: Final = {unit: float(np.radians(scale)) for unit, scale in DEGREES.items()} | {"mrad": 1e-3}
SPEEDS: Final = {f"{unit}/s": scale for unit, scale in METRES.items()} | {
    "mps": 1.0,
    "km/h": 1.0 / 3.6,
    "kmh": 1.0 / 3.6,
    "kph": 1.0 / 3.6,
    "mph": 0.44704,
    "knots": 1852.0 / 3600.0,
}
RATES: Final = {f"{unit}/s": scale for unit, scale in RADIANS.items()} | {
    "rads": 1.0,
    "dps": float(np.radians(1.0)),
    "degs": float(np.radians(1.0)),
    "rpm": 2.0 * np.pi / 60.0,
}
"""Units of lengths, angles, speeds and rates of turn, in small letters, and what they are in m, deg, rad, m/s and rad/s."""
_BRACKETED: Final = re.compile(r"[\s_]*(?:\s\w+)*\s*[\[({](.*)[\])}]\s*")


def find_column(path: Path, names: Sequence[str], name: str, units: dict[str, float]) -> tuple[int, float] | None:
    """Finds a column by its name; returns its number and the factor that brings it to the first of the units.

    Args:
        path: the file, for the error.
        names: of the columns, in small letters.
        name: of the column, behind which a unit may follow: `yaw [deg]`, `yaw(deg)`, `yaw_deg`.
        units: that such a column may have, and their factors.

    Returns:
        None where no column has the name.

    Raises:
        DataError: the column states a unit that is none of these.
    """
    if name in names:
        return names.index(name), 1.0
    for column, full in enumerate(names):
        rest = full[len(name) :]
        if not full.startswith(name) or not rest:
            continue
        bracketed = _BRACKETED.fullmatch(rest)
        words = [word for word in re.split(r"[\s_]+", bracketed[1] if bracketed else rest) if word and word != "per"]
        unit = "/".join(words).replace("//", "/").replace("///", "/")
        if unit in units and (bracketed or rest[0] in " _"):
            return column, units[unit]
        if bracketed:
            problem = f"column {full} states a unit that {name} cannot be converted from"
            raise DataError(path, problem, f"give it in {next(iter(units))}, or one of {', '.join(units)}")
        if rest[0] == " ":  # more words, and no unit
            return column, 1.0
    return None


def find_stamps(names: Sequence[str]) -> list[tuple[int, str]]:
    """Finds the columns of stamps and their units: one, or two where one holds seconds and another their nanoseconds."""
    units = [(column, unit) for column, name in enumerate(names) if (unit := time_unit(name)) is not None]
    seconds, nanoseconds = ([pair for pair in units if pair[1] == unit] for unit in ("s", "ns"))
    return [seconds[0], nanoseconds[0]] if seconds and nanoseconds else units[:1]


def join_stamps(words: Sequence[Sequence[str]], units: Sequence[str]) -> NDArray[np.int64]:
    """Joins words (N,) of one column, or of seconds and of nanoseconds, to stamps (N,) [us].

    Args:
        words: of each of the columns.
        units: of the columns; "" guesses one from its size.

    Raises:
        ValueError: a word is no stamp.
    """
    if len(words) == 1:
        return parse_stamps(words[0], units[0])
    whole, parts = words
    if not all(word.isascii() and word.isdigit() for word in parts):
        raise ValueError("holds nanoseconds that are no whole numbers")
    if any(len(word) > 9 and int(word) >= 10**9 for word in parts):  # stamps of their own
        return parse_stamps(parts, "ns")
    if not all(word.lstrip("-").isascii() and word.lstrip("-").isdigit() for word in whole):
        return parse_stamps(whole, "s")
    return parse_stamps([f"{second}.{int(part):09d}" for second, part in zip(whole, parts, strict=True)], "s")
