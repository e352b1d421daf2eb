"""GNSS fixes in NMEA 0183 logs: positions from GGA, dates from RMC or ZDA.

Source: NMEA 0183, with the fields of gpsd.gitlab.io/gpsd/NMEA.html. A sentence is `$TTSSS,field,...*HH`: two letters for the
talker, three for the kind, and the exclusive or of all characters between $ and * as two hexadecimal digits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import reduce
from operator import xor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mqslam.core.sensors import Fixes
from mqslam.core.wording import count_of, is_or_are
from mqslam.errors import DataError, untrusted
from mqslam.formats.sensors.reading import Reading, make_fixes
from mqslam.formats.sensors.sensor_table import SensorTable

_DAY_US = 86_400_000_000
_MEASURED = ("1", "2", "3", "4", "5", "9")  # qualities of a GGA that are fixes: not none, estimated, entered or simulated
_FIRST_YEAR = 1980  # GPS time begins here: years of two digits are those since then
_LONGEST_SENTENCE = 1000  # characters; the standard allows 82, and no receiver writes many more


class _Sentence(NamedTuple):
    """A sentence of a log.

    Args:
        kind: its three letters, such as `GGA`.
        fields: the words after its name.
        is_sound: whether its checksum is right.
    """

    kind: str
    fields: list[str]
    is_sound: bool


@dataclass(slots=True)
class _Log:
    """The sentences of a log.

    Args:
        anchor_us: a stamp [us] that the next time of day lies within half a day of.
        stamps_us: [us] of the fixes.
        places: latitude and longitude [degrees] of the fixes.
        damaged: number of sentences that cannot be used.
        positions: number of positions, sound or not.
        unchecked: number of positions whose checksum is wrong or missing.
        unfixed: number of positions that are no fixes.
    """

    anchor_us: int
    stamps_us: list[int] = field(default_factory=list)
    places: list[tuple[float, float]] = field(default_factory=list)
    damaged: int = 0
    positions: int = 0
    unchecked: int = 0
    unfixed: int = 0

    def add(self, sentence: _Sentence) -> None:
        """Takes in a sentence, or counts it as damaged."""
        is_position = sentence.kind == "GGA"
        self.positions += is_position
        if not sentence.is_sound:
            self.unchecked += is_position
            self.damaged += 1
            return
        try:
            self._take(sentence.kind, sentence.fields)
        except (ValueError, IndexError, OverflowError):
            self.damaged += 1

    def describe_lack(self) -> str:
        """Returns why a log holds no fix, in words."""
        if not self.positions:
            return "holds no GGA sentence"
        counts = {
            "with a wrong or missing checksum": self.unchecked,
            "in which the receiver states no fix": self.unfixed,
            "with a damaged field": self.positions - self.unchecked - self.unfixed,
        }
        reasons = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
        return f"holds {count_of(self.positions, 'GGA sentence')} and no fix: {reasons}"

    def _take(self, kind: str, fields: Sequence[str]) -> None:
        """Takes in a sound sentence: a date moves the anchor, and a position becomes a fix.

        Raises:
            ValueError: a field is no number.
            IndexError: a field is missing.
        """
        date = _read_date(kind, fields)
        if date is not None:
            self.anchor_us = date
        if kind != "GGA":
            return
        if fields[5] not in _MEASURED:
            self.unfixed += 1
            return
        place = _read_angle(fields[1], fields[2], "NS"), _read_angle(fields[3], fields[4], "EW")
        # the instant of this time of day that is nearest to the anchor: a log may pass midnight between two dates
        self.anchor_us += (_read_clock(fields[0]) - self.anchor_us + _DAY_US // 2) % _DAY_US - _DAY_US // 2
        self.stamps_us.append(self.anchor_us)
        self.places.append(place)


def read_nmea(path: Path, start_us: int) -> Reading[Fixes]:
    """Reads the fixes of an NMEA log, whose clock is UTC.

    A GGA states the time of day only. The day is that of the RMC or ZDA before it or, if there is none, of the first one
    after it; in a log without any it is the day that brings the first fix nearest to the recording's start.

    Args:
        path: the log; anything before the $ of a line is left out.
        start_us: stamp of the recording's start [us since 1970, UTC].

    Raises:
        DataError: the log cannot be read, or holds no fix.
    """
    dates = (_read_date_or_none(some.kind, some.fields) for some in _list_sentences(path) if some.is_sound)
    first = next((date for date in dates if date is not None), None)
    log = _Log(start_us if first is None else first)
    for sentence in _list_sentences(path):
        log.add(sentence)
    if not log.stamps_us:
        raise DataError(path, log.describe_lack(), "give the log as a receiver with fixes writes it: GGA with checksums")
    places = np.array(log.places, dtype=np.float64)
    columns = np.column_stack([places, np.full(len(places), np.nan)])
    made = make_fixes(path, str(path), SensorTable(np.array(log.stamps_us, dtype=np.int64), columns))
    notes, faults = list(made.notes), list(made.faults)
    if first is None:
        notes.append(f"{path} states no date (RMC or ZDA): it is taken to be of the day of the recording's start")
    if log.unfixed:
        notes.append(f"{count_of(log.unfixed, 'position')} in {path} {is_or_are(log.unfixed)} no fix, and left out")
    if log.damaged:
        count = count_of(log.damaged, "sentence")
        faults.append(f"{path}: {count} {is_or_are(log.damaged)} left out: damaged, or with a wrong checksum")
    return Reading(made.sensor, tuple(notes), tuple(faults))


def _list_sentences(path: Path) -> Iterator[_Sentence]:
    """Lists the sentences of a log, also those whose checksum is wrong or missing.

    Raises:
        DataError: the log cannot be read.
    """
    try:
        with untrusted.open_text(path, "ascii", "replace") as lines:
            for line in lines:
                _, dollar, sentence = line.partition("$")
                if not dollar:
                    continue
                body, star, checksum = sentence.strip().rpartition("*")
                is_sound = len(body) <= _LONGEST_SENTENCE and checksum.upper() == f"{reduce(xor, body.encode(), 0):02X}"
                name, *fields = (body if star else checksum)[:_LONGEST_SENTENCE].split(",")
                yield _Sentence(name[2:], fields, is_sound)
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror})", "check its permissions") from error


def _read_date_or_none(kind: str, fields: Sequence[str]) -> int | None:
    """Returns the stamp [us] of a sentence that states time and date, or None for one that does not, or is damaged."""
    try:
        return _read_date(kind, fields)
    except (ValueError, IndexError, OverflowError):
        return None


def _read_date(kind: str, fields: Sequence[str]) -> int | None:
    """Returns the stamp [us] of a sentence that states time and date; receivers without a clock yet leave both empty.

    Raises:
        ValueError: it states no date that there is.
        IndexError: a field is missing.
    """
    if kind == "RMC" and fields[0] and fields[8]:
        day, month, year = int(fields[8][:2]), int(fields[8][2:4]), int(fields[8][4:6])
        year += 100 * ((_FIRST_YEAR - year + 99) // 100)
    elif kind == "ZDA" and fields[0] and fields[3]:
        day, month, year = int(fields[1]), int(fields[2]), int(fields[3])
    else:
        return None
    return round(datetime(year, month, day, tzinfo=UTC).timestamp()) * 1_000_000 + _read_clock(fields[0])


def _read_clock(text: str) -> int:
    """Reads a time of day `hhmmss.ss` as microseconds since midnight.

    Raises:
        ValueError: it is none.
    """
    hours, minutes, seconds = int(text[:2]), int(text[2:4]), float(text[4:])
    if not (0 <= hours < 24 and 0 <= minutes < 60 and 0.0 <= seconds < 61.0):
        raise ValueError(text)
    return (hours * 60 + minutes) * 60_000_000 + round(seconds * 1e6)


def _read_angle(text: str, side: str, sides: str) -> float:
    """Reads an angle `dddmm.mmmm` and the side that it lies on as degrees, positive on the first of the sides.

    Raises:
        ValueError: it is none.
    """
    if side not in tuple(sides):
        raise ValueError(side)
    degrees, minutes = divmod(float(text), 100.0)
    return (degrees + minutes / 60.0) * (1.0 if side == sides[0] else -1.0)
