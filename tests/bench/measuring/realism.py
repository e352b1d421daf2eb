"""How alike recordings are in power and returns: a row per figure, a column per recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from bench.benchmark import Column, Row, label
from worlds.statistics import describe_statistics

_FIGURES = {  # name of a figure: what it is, format
    "returns_per_azimuth": ("returns per azimuth", ".2f"),
    "power": ("power at 50 / 90 / 99 / 99.9 %", ".0f"),
    "loud": ("share of bins over 40 / 60 / 80", ".3f"),
    "azimuth_correlation": ("correlation 1 / 2 / 4 azimuths on", ".2f"),
    "range_correlation": ("correlation 0.2 / 0.5 / 1 / 2 m on", ".2f"),
    "ranges": ("range of 50 / 90 % of the returns [m]", ".0f"),
    "repeats": ("returns within 0.5 m 1 / 4 scans on", ".2f"),
    "chance": ("the same by chance", ".2f"),
    "unmatched": ("no return within 1 m in the next scan", ".2f"),
    "radial_spread_m": ("spread in range of pairs [m]", ".2f"),
    "matched": ("matched share", ".2f"),
    "psi_per_point": ("psi per point", ".2f"),
}


def make_columns(names: Mapping[str, str]) -> tuple[Column, ...]:
    """Returns the columns of a table of recordings, given what each is called by its key."""
    return label("figure", ""), *(Column(key, head, "{}") for key, head in names.items())


def measure_realism(recordings: Mapping[str, Path]) -> list[Row]:
    """Returns a row per figure, for recordings by their key."""
    figures = {key: describe_statistics(data) for key, data in recordings.items()}
    return [
        Row({"figure": shown} | {key: _join(getattr(one, name), form) for key, one in figures.items()}, judged=False)
        for name, (shown, form) in _FIGURES.items()
    ]


def _join(value: float | tuple[float, ...], form: str) -> str:
    values = value if isinstance(value, tuple) else (value,)
    return " / ".join(format(number, form) for number in values)
