"""Reads GNSS fixes from NMEA 0183 logs: positions from GGA, dates from RMC or ZDA.

Source: NMEA 0183, with the fields of gpsd.gitlab.io/gpsd/NMEA.html. A sentence is `$TTSSS,field,...*HH`: two letters for the
talker, three for the kind, and the exclusive or of all characters between $ and * as two hexadecimal digits.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np

from mqslam.core.sensors import Fixes
from mqslam.core.wording import count_of, is_or_are
from mqslam.errors import DataError
from mqslam.formats.sensors.reading import Reading, make_fixes
from mqslam.formats.tables import SensorTable
from mqslam.formats.text import open_lines

_DAY_US = 86_400_000_000
_MEASURED = ("1", "2", "3", "4", "5", "9")  # qualities of a measured fix; others: none, estimated or simulated
_FIRST_YEAR = 1980  # GPS time begins here: a year of two digits lies in the hundred years from 1980
_LONGEST_SENTENCE = 1000  # characters; the standard allows 82, and no receiver writes many more
_REMEDY = "give the log as a receiver with fixes writes it: GGA with checksums"
_UNCHECKED, _UNFIXED = "with a wrong or missing checksum", "in which the receiver states no fix"
_DAMAGE = (ValueError, IndexError, OverflowError)


def read_nmea(path: Path, start_us: int) -> Reading[Fixes]:
    """Reads the fixes of an NMEA log, with stamps in UTC.

    A GGA sentence states only the time of day. Of all instants with this time of day, the nearest to a known stamp is taken:
    (1) to the last fix, RMC or ZDA before the sentence; (2) if there is none, to the first RMC or ZDA after it; (3) for the
    first fix in a log without RMC and ZDA, to the recording's start.

    Args:
        path: the log; anything before the $ of a line is left out.
        start_us: stamp of the recording's start [us since 1970, UTC].

    Raises:
        DataError: the log cannot be read, or holds no fix.
    """
    first = _find_first_date(path)
    anchor_us = start_us if first is None else first  # the next time of day lies within half a day of this stamp
    stamps: list[int] = []
    places: list[tuple[float, float]] = []
    damaged, positions, useless = 0, 0, Counter[str]()
    for kind, fields, is_sound in _list_sentences(path):
        is_position = kind == "GGA"
        positions += is_position
        if not is_sound:
            useless[_UNCHECKED] += is_position
            damaged += 1
            continue
        try:
            date = _read_date(kind, fields)
            anchor_us = anchor_us if date is None else date
            if is_position and fields[5] not in _MEASURED:
                useless[_UNFIXED] += 1
            elif is_position:
                place = _read_angle(fields[1], fields[2], "NS"), _read_angle(fields[3], fields[4], "EW")
                # the instant of this time of day that is nearest to the anchor: a log may pass midnight between two dates
                anchor_us += (_read_clock(fields[0]) - anchor_us + _DAY_US // 2) % _DAY_US - _DAY_US // 2
                stamps.append(anchor_us)
                places.append(place)
        except _DAMAGE:
            damaged += 1
    if not stamps:
        raise DataError(path, _describe_lack(positions, useless), _REMEDY)
    unfixed = useless[_UNFIXED]
    made = make_fixes(path, SensorTable(np.array(stamps, dtype=np.int64), np.array(places, dtype=np.float64)))
    notes, faults = list(made.notes), list(made.faults)
    if first is None:
        notes.append(f"{path} states no date (RMC or ZDA): the day of the recording's start is assumed")
    if unfixed:
        notes.append(f"{count_of(unfixed, 'position')} in {path} {is_or_are(unfixed)} left out: the receiver states no fix")
    if damaged:
        count = count_of(damaged, "sentence")
        faults.append(f"{path}: {count} {is_or_are(damaged)} left out: damaged, or with a wrong checksum")
    return Reading(made.sensor, tuple(notes), tuple(faults))


def _describe_lack(positions: int, useless: Counter[str]) -> str:
    """Describes why a log holds no fix.

    Args:
        positions: number of GGA sentences in the log.
        useless: number of GGA sentences with a wrong checksum (`_UNCHECKED`) and of those without a fix (`_UNFIXED`).
    """
    if not positions:
        return "holds no GGA sentence"
    counts = {what: useless[what] for what in (_UNCHECKED, _UNFIXED)}
    counts["with a damaged field"] = positions - useless.total()
    reasons = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
    return f"holds {count_of(positions, 'GGA sentence')} and no fix: {reasons}"


def _list_sentences(path: Path) -> Iterator[tuple[str, list[str], bool]]:
    """Yields for each sentence of a log its kind, such as GGA, its fields, and whether its checksum and length are right."""
    with open_lines(path, _REMEDY, "replace") as lines:
        for line in lines:
            _, dollar, sentence = line.partition("$")
            if not dollar:
                continue
            body, star, checksum = sentence.strip().rpartition("*")
            is_sound = len(body) <= _LONGEST_SENTENCE and checksum.upper() == f"{reduce(xor, body.encode(), 0):02X}"
            name, *fields = (body if star else checksum)[:_LONGEST_SENTENCE].split(",")
            yield name[2:], fields, is_sound


def _find_first_date(path: Path) -> int | None:
    """Returns the stamp [us] of the first sentence that states time and date, or None if no sentence does."""
    for kind, fields, is_sound in _list_sentences(path):
        with suppress(*_DAMAGE):
            if is_sound and (date := _read_date(kind, fields)) is not None:
                return date
    return None


def _read_date(kind: str, fields: Sequence[str]) -> int | None:
    """Returns the stamp [us] of an RMC or ZDA sentence; None if its time or date is empty, and for other sentences.

    Raises:
        ValueError: the sentence states a date that does not exist.
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
    """Reads a time of day `hhmmss.ss` as microseconds since midnight; raises ValueError if it is no time of day."""
    hours, minutes, seconds = int(text[:2]), int(text[2:4]), float(text[4:])
    if not (0 <= hours < 24 and 0 <= minutes < 60 and 0.0 <= seconds < 61.0):
        raise ValueError(text)
    return (hours * 60 + minutes) * 60_000_000 + round(seconds * 1e6)


def _read_angle(text: str, side: str, sides: str) -> float:
    """Reads an angle `dddmm.mmmm` as degrees, negative if `side` is the second of `sides`, such as S of NS.

    Raises:
        ValueError: the text is no angle, or `side` is neither of the two.
    """
    if side not in tuple(sides):
        raise ValueError(side)
    degrees, minutes = divmod(float(text), 100.0)
    return (degrees + minutes / 60.0) * (1.0 if side == sides[0] else -1.0)
