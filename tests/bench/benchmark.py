"""A benchmark: rows that a function makes from recordings, the columns that show them, and what is too bad."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path
from typing import Any, NamedTuple

Cell = str | float | None


class MissingData(Exception):
    """A benchmark needs something that this machine does not have."""


class Goal(Enum):
    """Which values of a column are good."""

    LOW = auto()  # an error
    HIGH = auto()  # a share of what is right
    ONE = auto()  # a ratio that is right at one
    FAST = auto()  # a time over another one, which varies from run to run

    @property
    def tolerated(self) -> float:
        """The loss against the baseline that is tolerated."""
        return 0.25 if self is Goal.FAST else 0.05


class Column(NamedTuple):
    """A column of a table."""

    key: str  # name of its cells
    head: str  # as the table shows it, with its unit
    form: str = "{:.3g}"  # format of its numbers
    goal: Goal | None = None  # which values are good, for a column that is compared with the baseline
    label: bool = False  # whether its texts tell a row from the others


def label(key: str, head: str) -> Column:
    """Returns a column whose texts tell a row from the others."""
    return Column(key, head, "{}", label=True)


class Row(NamedTuple):
    """A row of a table."""

    cells: Mapping[str, Cell]  # texts and numbers by the key of their column; a number that is not known is None
    judged: bool = True  # whether the row is compared with the baseline: one of our own, and one that chance does not decide


class Bound(NamedTuple):
    """Limits that cells must keep, whatever the baseline is."""

    key: str  # the column
    where: Mapping[str, str]  # texts that a row has in other columns if the limits concern it
    least: float = float("-inf")  # the limits
    most: float = float("inf")  # the limits


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """A benchmark."""

    what: str  # what is measured, in a sentence
    data: str  # what it is measured on: `simulated` by mqslam itself, or `twin` or `real`, which mqslam does not ship
    seeds: tuple[int, ...] = ()  # of the simulated recordings
    columns: tuple[Column, ...]  # of its table
    measure: Callable[[Path], list[Row]]  # makes the rows; it may use the folder it is given, and raises MissingData
    bounds: tuple[Bound, ...] = ()  # limits that rows must keep
    study: bool = False  # whether it takes so long that it is run only if it is named, or all are asked for

    def name_row(self, row: Mapping[str, Any]) -> str:
        """Returns the texts that tell a row from the others."""
        return ", ".join(str(row.get(column.key)) for column in self.columns if column.label)

    def find_missed(self, name: str, rows: Sequence[Mapping[str, Any]], *, is_whole: bool = True) -> list[str]:
        """Returns a sentence for every figure that misses a bound, and for every bound that concerns no figure.

        Args:
            name: of the benchmark.
            rows: of its table.
            is_whole: whether these are all rows of the table, so that each bound should concern one of them.
        """
        missed = []
        for bound in self.bounds:
            concerned = [row for row in rows if all(row.get(key) == text for key, text in bound.where.items())]
            if not concerned and is_whole:
                missed.append(f"{name}: no row has {', '.join(bound.where.values())}, whose {bound.key} has a bound")
            limits = [f"at least {bound.least:g}"] if bound.least > float("-inf") else []
            limits += [f"at most {bound.most:g}"] if bound.most < float("inf") else []
            for row in concerned:
                value = row.get(bound.key)
                if value is None or not bound.least <= value <= bound.most:
                    shown = "not known" if value is None else f"{value:.4g}"
                    figure = f"{name}, {self.name_row(row)}: {bound.key} is {shown}"
                    missed.append(f"{figure}; it must be {' and '.join(limits)}")
        return missed

    def find_losses(self, name: str, rows: Sequence[Mapping[str, Any]], baseline: Sequence[Mapping[str, Any]]) -> list[str]:
        """Returns a sentence for every judged figure that is worse than in the baseline by more than its goal tolerates."""
        losses = []
        now = {self.name_row(row): row for row in rows}
        for before in baseline:
            row = self.name_row(before)
            if not before["judged"]:
                continue
            if row not in now:
                losses.append(f"{name}: the row {row} of the baseline is missing")
                continue
            for column in self.columns:
                old, new = before.get(column.key), now[row].get(column.key)
                if column.goal is None or old is None:
                    continue
                figure = f"{name}, {row}: {column.key} was {old:.4g} and is"
                if new is None:
                    losses.append(f"{figure} not known")
                elif (loss := measure_loss(column.goal, old, new)) > column.goal.tolerated:
                    losses.append(f"{figure} {new:.4g}, a loss of {loss:.0%}")
        return losses


def measure_loss(goal: Goal, before: float, now: float) -> float:
    """Returns by which part a figure got worse; it is negative where the figure got better."""
    if goal is Goal.HIGH:
        before, now = now, before
    elif goal is Goal.ONE:
        before, now = (max(value, 1.0 / value) if value > 0.0 else float("inf") for value in (before, now))
    if before == now:
        return 0.0
    return now / before - 1.0 if before > 0.0 else float("inf")
