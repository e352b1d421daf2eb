"""A benchmark: rows that a function makes from recordings, the columns that show them, and the bounds they must keep."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path
from typing import NamedTuple

Cell = str | float | None
_FOLDER = Path(__file__).with_name("benchmarks")


class MissingData(Exception):
    """A benchmark needs something that this machine does not have."""


class Goal(Enum):
    """Which values of a column are good."""

    LOW = auto()  # an error
    HIGH = auto()  # a share of what is right
    ONE = auto()  # a ratio that is right at one
    FAST = auto()  # a time over another one, which varies from run to run


class Column(NamedTuple):
    """A column of a table.

    Args:
        key: name of its cells.
        head: as the table shows it, with its unit.
        form: format of its numbers.
        goal: which values are good, for a column that is compared with the baseline.
        label: whether its texts tell a row from the others.
    """

    key: str
    head: str
    form: str = "{:.3g}"
    goal: Goal | None = None
    label: bool = False


def label(key: str, head: str) -> Column:
    """Returns a column whose texts tell a row from the others."""
    return Column(key, head, "{}", label=True)


class Row(NamedTuple):
    """A row of a table.

    Args:
        cells: texts and numbers by the key of their column; a number that is not known is None.
        judged: whether the row is compared with the baseline: one of our own, and one that chance does not decide.
    """

    cells: Mapping[str, Cell]
    judged: bool = True


class Bound(NamedTuple):
    """Limits that cells must keep, whatever the baseline is.

    Args:
        key: the column.
        where: texts that a row has in other columns if the limits concern it.
        least, most: the limits.
    """

    key: str
    where: Mapping[str, str]
    least: float = float("-inf")
    most: float = float("inf")


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """A benchmark.

    Args:
        what: what is measured, in a sentence.
        data: what it is measured on: `simulated` by mqslam itself, or `twin` or `real`, which mqslam does not ship.
        seeds: of the simulated recordings.
        columns: of its table.
        measure: makes the rows; it may use the folder it is given, and raises MissingData.
        bounds: limits that rows must keep.
    """

    what: str
    data: str
    seeds: tuple[int, ...] = ()
    columns: tuple[Column, ...]
    measure: Callable[[Path], list[Row]]
    bounds: tuple[Bound, ...] = ()


def list_benchmarks() -> list[str]:
    """Lists the names of all benchmarks: those of their files, first of those that need nothing but mqslam."""
    return [path.stem for folder in ("simulated", "shared") for path in sorted((_FOLDER / folder).glob("[a-z]*.py"))]


def load_benchmark(name: str) -> Benchmark:
    """Returns the benchmark that goes by a name."""
    (path,) = _FOLDER.glob(f"*/{name}.py")
    benchmark: Benchmark = importlib.import_module(f"bench.benchmarks.{path.parent.name}.{name}").BENCHMARK
    return benchmark
