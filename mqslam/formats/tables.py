"""Columns of tables by their names, which may state a unit: it is converted, or the column is refused by its name."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError, untrusted
from mqslam.formats.stamps import LATEST_US, UNITS, guess_unit, parse_stamps, time_unit

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
_LONGEST_LINE = 10_000  # characters of a table's first line: in a longer one the file is no table
_LISTED = 20  # columns that an error names
Parse = Callable[[str], float]


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


@dataclass(frozen=True, slots=True)
class SensorTable:
    """Rows of a sensor's readings.

    Args:
        stamps_us: (N,) int64 [us], in the order of the file.
        columns: (N, C); NaN where a row holds no number.
        unread: number of rows beside these, whose stamps are no numbers.
    """

    stamps_us: NDArray[np.int64]
    columns: NDArray[np.float64]
    unread: int = 0

    def with_columns(self, columns: NDArray[np.float64]) -> SensorTable:
        """Returns the same rows with other columns (N, D)."""
        return SensorTable(self.stamps_us, columns, self.unread)


@dataclass(frozen=True, slots=True)
class Header:
    """The first line of a table.

    Args:
        path: the file.
        names: words of the line, in small letters.
        line: number of lines up to and including it.
    """

    path: Path
    names: tuple[str, ...]
    line: int

    @property
    def holds_numbers(self) -> bool:
        """Whether the line is a row of numbers already, and the table has no header."""
        try:
            return bool(np.isfinite(float(self.names[0])))
        except ValueError:
            return False

    def find(self, names: Sequence[str], remedy: str) -> list[int]:
        """Finds the columns of some names.

        Raises:
            DataError: one is missing.
        """
        missing = [name for name in names if name not in self.names]
        if missing:
            listed = ", ".join(self.names[:_LISTED])
            raise DataError(self.path, f"has no column {', '.join(missing)} (columns: {listed})", remedy)
        return [self.names.index(name) for name in names]


def read_header(path: Path, remedy: str) -> Header:
    """Reads the first line of a text file that is neither empty nor a comment.

    Raises:
        DataError: there is none, or the file does not exist or is no text.
    """
    try:
        with untrusted.open_text(path, "utf-8-sig") as file:
            number = 0
            while line := file.readline(_LONGEST_LINE):
                number += 1
                if line.strip() and not line.startswith("#"):
                    return Header(path, tuple(word.strip(" \"'\r\n").lower() for word in line.split(",")), number)
    except FileNotFoundError as error:
        raise DataError(path, "does not exist", "check the path") from error
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(path, "is not a readable text file", remedy) from error
    raise DataError(path, "is empty", remedy)


def read_sensor_table(
    header: Header, columns: Sequence[int], unit: str = "", parse: Mapping[int, Parse] | None = None
) -> SensorTable:
    """Reads columns of a table; a cell that is no number costs its row and no other.

    Stamps go through a float, which holds those since 1970 to a quarter of a microsecond.

    Args:
        header: its first line.
        columns: of the stamp, and of the readings.
        unit: of the stamps, one of `UNITS`; "" guesses it from their size.
        parse: turns the words of some of the columns into numbers.

    Raises:
        DataError: the file cannot be read.
    """
    skipped = 0 if header.holds_numbers else header.line
    numbers = _read_numbers(header.path, columns, skipped, parse or {})
    stamps = numbers[:, 0]
    timed = np.isfinite(stamps)
    scale = float(UNITS[unit or guess_unit(float(np.median(np.abs(stamps[timed]))) if timed.any() else 0.0)])
    timed &= np.abs(np.where(timed, stamps, 0.0)) * scale < LATEST_US
    stamps_us = np.round(stamps[timed] * scale).astype(np.int64)
    return SensorTable(stamps_us, numbers[timed, 1:], int(np.count_nonzero(~timed)))


def read_converted(header: Header, wanted: Sequence[tuple[str, dict[str, float]]], remedy: str) -> SensorTable:
    """Reads columns whose names may state their units; stamps that state none are in microseconds.

    Args:
        header: the first line of the table.
        wanted: names of the columns beside that of the stamps, and the units that each may have.
        remedy: what to give in place of the file.

    Raises:
        DataError: the file cannot be read, or a column is missing or states a unit that cannot be converted.
    """
    stamps = find_stamps(header.names)
    found = [find_column(header.path, header.names, name, units) for name, units in wanted]
    if not stamps or None in found:
        lacking = [name for (name, _), column in zip(wanted, found, strict=True) if column is None]
        header.find([*([] if stamps else ["t"]), *lacking], remedy)
    columns, factors = zip(*(column for column in found if column is not None), strict=True)
    table = read_sensor_table(header, [*(column for column, _ in stamps), *columns], stamps[0][1] or "us")
    readings, stamps_us = table.columns[:, len(stamps) - 1 :] * np.array(factors), table.stamps_us
    if len(stamps) == 1:
        return table.with_columns(readings)
    parts_us = np.round(np.nan_to_num(table.columns[:, 0]) / 1000.0).astype(np.int64)
    own = np.abs(parts_us).max(initial=0) > 10**6  # stamps of their own, in nanoseconds
    return SensorTable(parts_us if own else stamps_us + parts_us, readings, table.unread)


def _read_numbers(path: Path, columns: Sequence[int], skipped: int, parse: Mapping[int, Parse]) -> NDArray[np.float64]:
    """Reads columns (N, len(columns)) of all lines but the first ones; NaN where a cell is no number."""
    try:
        with untrusted.open_text(path, "utf-8-sig") as file:
            for _ in range(skipped):
                file.readline()
            if not any(line.split("#", 1)[0].strip() for line in file):  # NumPy warns of a file without rows
                return np.empty((0, len(columns)))
        with untrusted.open_text(path, "utf-8-sig") as file:
            words: dict[int | str, Parse] = dict(parse.items())
            return np.loadtxt(
                file, delimiter=",", converters=words or None, skiprows=skipped, usecols=list(columns), ndmin=2
            )
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror})", "check its permissions") from error
    except ValueError:  # some line is damaged: each is read by itself, which takes longer
        return _read_lines(path, columns, skipped, parse)


def _read_lines(path: Path, columns: Sequence[int], skipped: int, parse: Mapping[int, Parse]) -> NDArray[np.float64]:
    """Reads what `_read_numbers` does, line by line."""
    rows: list[list[float]] = []
    with untrusted.open_text(path, "utf-8-sig", "replace") as file:
        for number, line in enumerate(file):
            if number < skipped or not line.strip() or line.startswith("#"):
                continue
            words = line.split(",")
            rows.append([_parse_word(words, column, parse.get(column, float)) for column in columns])
    return np.array(rows, dtype=np.float64).reshape(-1, len(columns))


def _parse_word(words: Sequence[str], column: int, parse: Parse) -> float:
    """Parses a word of a line as a number; NaN where there is none."""
    try:
        return parse(words[column].strip())
    except (ValueError, IndexError):
        return float("nan")
