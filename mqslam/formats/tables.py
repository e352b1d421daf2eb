"""Reads tables of numbers from CSV, whose column names may state units; the table of a sensor may have damaged rows."""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.errors import DataError, untrusted
from mqslam.formats.stamps import LATEST_US, UNITS, guess_unit, parse_stamps, time_unit
from mqslam.formats.text import open_lines, read_lines

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
DIMENSIONLESS: Final = {"-": 1.0}
"""Units in lower case with their multipliers: lengths to m, angles to degrees and to rad, speeds to m/s, rates to rad/s."""
_BRACKETED: Final = re.compile(r"[\s_]*(?:\s\w+)*\s*[\[({](.*)[\])}]\s*")
_LONGEST_LINE = 10_000  # a file whose first line has more characters is no table
_LISTED = 20  # an error lists at most this many columns
_REPAIR = "repair or remove its line"
_GIVE_STAMPS = "give stamps in s, us or ns"
Parse = Callable[[str], float]
Wanted = Sequence[tuple[str, dict[str, float]]]
"""Names of columns, each with the units that the column may have and their multipliers to the first of these units."""


@dataclass(frozen=True, slots=True)
class Header:
    """The first line of a table, which names the columns unless the table has no header.

    Args:
        path: the file.
        names: words of the line, in lower case.
        line: number of the line in the file, from 1.
    """

    path: Path
    names: tuple[str, ...]
    line: int = 1

    @property
    def holds_numbers(self) -> bool:
        """Whether the line begins with a finite number, which shows that the table has no header."""
        try:
            return bool(np.isfinite(float(self.names[0])))
        except ValueError:
            return False

    def find(self, names: Sequence[str], remedy: str) -> list[int]:
        """Returns the indices, from 0, of the columns with exactly these names; the error advises `remedy`.

        Raises:
            DataError: a column is missing.
        """
        missing = [name for name in names if name not in self.names]
        if missing:
            raise self.refuse(missing, remedy)
        return [self.names.index(name) for name in names]

    def find_unit(self, name: str, units: dict[str, float]) -> tuple[int, float] | None:
        """Finds a column by its name.

        Args:
            name: name of the column, after which a unit may follow: `yaw [deg]`, `yaw(deg)`, `yaw_deg`.
            units: units that the column may have, each with the multiplier that converts it to the first of them.

        Returns:
            The column's index from 0 and the multiplier of its unit (1 if it states none); None if no column has the name.

        Raises:
            DataError: the column states in brackets a unit that is not one of `units`.
        """
        if name in self.names:
            return self.names.index(name), 1.0
        for column, full in enumerate(self.names):
            rest = full[len(name) :]
            if not full.startswith(name) or not rest:
                continue
            bracketed = _BRACKETED.fullmatch(rest)
            words = [word for word in re.split(r"[\s_]+", bracketed[1] if bracketed else rest) if word and word != "per"]
            unit = re.sub("/+", "/", "/".join(words))
            if unit in units and (bracketed or rest[0] in " _"):
                return column, units[unit]
            if bracketed:
                problem = f"column {full} states a unit in which {name} is not understood"
                first, *others = units
                known = f"give it in {first}, or one of {', '.join(units)}" if others else "leave the unit out"
                raise DataError(self.path, problem, known)
            if rest[0] == " ":  # more words follow, but no unit
                return column, 1.0
        return None

    def find_all(self, wanted: Wanted, remedy: str) -> tuple[list[tuple[int, str]], list[int], NDArray[np.float64]]:
        """Finds the columns of stamps and the W wanted columns.

        Returns:
            (1) index from 0 and unit of each column of stamps, as `find_stamps` returns them, (2) the indices from 0 of the
            wanted columns, (3) the multipliers (W,) of the units of the wanted columns.

        Raises:
            DataError: a column is missing, or states a unit that cannot be converted.
        """
        stamps = find_stamps(self.names)
        found = [self.find_unit(name, units) for name, units in wanted]
        missing = [] if stamps else ["t"]
        missing += [name for (name, _), column in zip(wanted, found, strict=True) if column is None]
        if missing:
            raise self.refuse(missing, remedy)
        columns, factors = zip(*(column for column in found if column is not None), strict=True)
        return stamps, list(columns), np.array(factors)

    def refuse(self, missing: Sequence[str], remedy: str) -> DataError:
        """Returns the error that columns are missing; it lists the columns that exist, at most 20, and advises `remedy`."""
        return DataError(
            self.path, f"has no column {', '.join(missing)} (columns: {', '.join(self.names[:_LISTED])})", remedy
        )


def split_header(line: str) -> tuple[str, ...]:
    """Returns the column names of a header line, in lower case; the line may be a comment, and its names may be quoted."""
    return tuple(word.strip(" \"'\ufeff\r\n").lower() for word in line.lstrip("# ").split(","))


def find_stamps(names: Sequence[str]) -> list[tuple[int, str]]:
    """Finds the columns of stamps by their names; returns the index, from 0, and the unit of each.

    A unit is one of `UNITS`, or "" if the name states none. If the header names both seconds and nanoseconds, the result is
    the first column of each; else it is the first column of stamps, or empty if there is none.
    """
    units = [(column, unit) for column, name in enumerate(names) if (unit := time_unit(name)) is not None]
    seconds, nanoseconds = ([pair for pair in units if pair[1] == unit] for unit in ("s", "ns"))
    return [seconds[0], nanoseconds[0]] if seconds and nanoseconds else units[:1]


def read_rows(path: Path, remedy: str) -> list[list[str]]:
    """Reads the rows of a CSV as words; blank lines and comments are left out.

    Raises:
        DataError: the file does not exist or is no text.
    """
    lines = (line.partition("#")[0] for line in read_lines(path, remedy))
    return [line.split(",") for line in lines if line.strip()]


def parse_numbers(
    path: Path, rows: Sequence[Sequence[str]], columns: Sequence[int], what: str = "row"
) -> NDArray[np.float64]:
    """Parses columns, given by index from 0, of N rows of words as numbers (N, len(columns)); errors call a row `what`.

    Raises:
        DataError: a word is not a finite number.
    """
    table = np.empty((len(rows), len(columns)))
    for row, words in enumerate(rows):
        try:
            table[row] = [float(words[column]) for column in columns]
        except (ValueError, IndexError):
            table[row] = np.nan
    if not np.isfinite(table).all():
        row = int(np.argmin(np.isfinite(table).all(axis=1)))
        raise DataError(path, f"{what} {row + 1} is not made of finite numbers", _REPAIR)
    return table


def parse_times(path: Path, words: Sequence[str], unit: str = "", remedy: str = _GIVE_STAMPS) -> NDArray[np.int64]:
    """Parses words (N,) as stamps (N,) [us]; `unit` is the unit of the words, and "" guesses it from their size.

    Raises:
        DataError: a word is no stamp.
    """
    try:
        return parse_stamps(words, unit)
    except ValueError as error:
        raise DataError(path, str(error), remedy) from error


def read_stamped(path: Path, columns: Sequence[int]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Reads the stamps (N,) [us] and the columns with given indices (N, len(columns)) of a CSV with or without a header.

    The first column holds whole stamps in us or ns, which a float would round. Rows are returned in the order of their
    stamps; of several rows with the same stamp, only the first is kept.

    Raises:
        DataError: the file cannot be read, or a row is too short or holds something other than finite numbers.
    """
    rows = read_rows(path, _REPAIR)
    rows = rows[1:] if rows and not rows[0][0].lstrip()[:1].isdigit() else rows
    stamps, order = np.unique(parse_times(path, [row[0].strip() for row in rows]), return_index=True)
    return stamps, parse_numbers(path, rows, columns)[order]


def read_converted(
    header: Header, rows: Sequence[Sequence[str]], wanted: Wanted, remedy: str, unit: str = "", what: str = "row"
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Returns the stamps (N,) [us] and the wanted columns (N, len(wanted)) of rows, each in the first unit that it may have.

    Args:
        header: the names of the columns.
        rows: the N rows, each as its words.
        wanted: the columns besides the stamps.
        remedy: advice of the errors on a file to give instead.
        unit: unit of stamps whose column states none; "" guesses it from their size.
        what: the word for a row in errors, such as `pose`.

    Raises:
        DataError: a column is missing or states a unit that cannot be converted, or a cell is no finite number or stamp.
    """
    stamps_at, columns, factors = header.find_all(wanted, remedy)
    times = [column for column, _ in stamps_at]
    table = parse_numbers(header.path, rows, [*times, *columns], what)[:, len(times) :] * factors
    try:
        words = [[row[column].strip() for row in rows] for column in times]
        return _join_stamps(words, [stated or unit for _, stated in stamps_at]), table
    except ValueError as error:
        raise DataError(header.path, str(error), _GIVE_STAMPS) from error


def _join_stamps(words: Sequence[Sequence[str]], units: Sequence[str]) -> NDArray[np.int64]:
    """Makes stamps (N,) [us] of the words (N,) of one column, or of a column of seconds and a column of nanoseconds.

    Raises:
        ValueError: a word is no stamp.
    """
    if len(words) == 1:
        return parse_stamps(words[0], units[0])
    whole, parts = words
    if not all(word.isascii() and word.isdigit() for word in parts):
        raise ValueError("holds nanoseconds that are no whole numbers")
    if any(len(word) > 9 and int(word) >= 10**9 for word in parts):  # the nanoseconds are complete stamps already
        return parse_stamps(parts, "ns")
    if not all(word.lstrip("-").isascii() and word.lstrip("-").isdigit() for word in whole):
        return parse_stamps(whole, "s")
    return parse_stamps([f"{second}.{int(part):09d}" for second, part in zip(whole, parts, strict=True)], "s")


@dataclass(frozen=True, slots=True)
class SensorTable:
    """A table of a sensor's readings.

    Args:
        stamps_us: (N,) int64 [us], in the order of the file.
        columns: (N, C) readings, one row per stamp; NaN where the file holds no number.
        unread: number of further rows that were left out because their stamps are not valid.
    """

    stamps_us: NDArray[np.int64]
    columns: NDArray[np.float64]
    unread: int = 0

    def with_columns(self, *columns: NDArray[np.float64]) -> SensorTable:
        """Returns a table with the same stamps and with these columns (N,) or (N, C), put side by side, as its readings."""
        return replace(self, columns=np.column_stack(columns))


def read_header(path: Path, remedy: str) -> Header:
    """Reads the header of a text file: the first of its lines that is neither empty nor a comment.

    Raises:
        DataError: there is no such line, or the file does not exist or is no text.
    """
    with open_lines(path, remedy) as file:
        number = 0
        while line := file.readline(_LONGEST_LINE):
            number += 1
            if line.strip() and not line.startswith("#"):
                return Header(path, split_header(line), number)
    raise DataError(path, "is empty", remedy)


def read_sensor_table(
    header: Header, columns: Sequence[int], unit: str = "", parse: Mapping[int, Parse] | None = None
) -> SensorTable:
    """Reads columns of a table. A cell that is no number becomes NaN; a row without a valid stamp is left out and counted.

    Stamps are parsed as floats: stamps since 1970 are exact to a quarter of a microsecond.

    Args:
        header: the first line of the table.
        columns: indices of the columns, from 0: the stamps first, then the readings.
        unit: unit of the stamps, one of `UNITS`; "" guesses it from their size.
        parse: by column, a function that converts a word to a number; all other columns are parsed as floats.

    Raises:
        DataError: the file cannot be read.
    """
    parsers = [(column, (parse or {}).get(column, float)) for column in columns]
    numbers, skipped = array("d"), 0 if header.holds_numbers else header.line
    with untrusted.open_text(header.path, "replace") as file:
        for number, line in enumerate(file):
            words = line.partition("#")[0].split(",")
            if number < skipped or not (len(words) > 1 or words[0].strip()):
                continue
            numbers.extend(_parse_word(words, column, parse_word) for column, parse_word in parsers)
    table = np.array(numbers, dtype=np.float64).reshape(-1, len(columns))
    stamps = table[:, 0]
    timed = np.isfinite(stamps)
    scale = float(UNITS[unit or guess_unit(float(np.median(np.abs(stamps[timed]))) if timed.any() else 0.0)])
    timed &= np.abs(np.where(timed, stamps, 0.0)) * scale < LATEST_US
    stamps_us = np.round(stamps[timed] * scale).astype(np.int64)
    return SensorTable(stamps_us, table[timed, 1:], int(np.count_nonzero(~timed)))


def _parse_word(words: Sequence[str], column: int, parse: Parse) -> float:
    """Parses the word in a column of a row as a number; returns NaN if the word is missing or no number."""
    try:
        return parse(words[column])
    except (ValueError, IndexError):
        return float("nan")


def read_converted_sensor(header: Header, wanted: Wanted, remedy: str) -> SensorTable:
    """Reads a sensor's stamps and its wanted columns, each in the first unit that it may have; stamps without unit are us.

    Args:
        header: the first line of the table.
        wanted: the columns besides the stamps.
        remedy: advice of the errors on a file to give instead.

    Raises:
        DataError: the file cannot be read, or a column is missing or states a unit that cannot be converted.
    """
    stamps, columns, factors = header.find_all(wanted, remedy)
    table = read_sensor_table(header, [*(column for column, _ in stamps), *columns], stamps[0][1] or "us")
    readings, stamps_us = table.columns[:, len(stamps) - 1 :] * factors, table.stamps_us
    if len(stamps) > 1:
        parts_us = np.round(np.nan_to_num(table.columns[:, 0]) / 1000.0).astype(np.int64)
        own = np.abs(parts_us).max(initial=0) > 10**6  # the nanoseconds are complete stamps already
        stamps_us = parts_us if own else stamps_us + parts_us
    return SensorTable(stamps_us, readings, table.unread)
