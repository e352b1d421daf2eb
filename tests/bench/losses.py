"""What is worse than it must be: figures beyond their bounds, and figures that lost against the baseline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.benchmark import Bound, Column, Goal
from bench.results import Result

_TOLERATED = {Goal.FAST: 0.25}
_TOLERATED_ELSE = 0.05


def find_missed(result: Result, columns: Sequence[Column], bounds: Sequence[Bound]) -> list[str]:
    """Returns a sentence for every figure that misses a bound, and for every bound that concerns no figure."""
    missed = []
    for bound in bounds:
        rows = [row for row in result.rows if all(row.get(key) == text for key, text in bound.where.items())]
        if not rows:
            missed.append(f"{result.name}: no row has {', '.join(bound.where.values())}, whose {bound.key} has a bound")
        limits = [f"at least {bound.least:g}"] if bound.least > float("-inf") else []
        limits += [f"at most {bound.most:g}"] if bound.most < float("inf") else []
        for row in rows:
            value = row.get(bound.key)
            if value is None or not bound.least <= value <= bound.most:
                shown = "not known" if value is None else f"{value:.4g}"
                missed.append(
                    f"{result.name}, {_name(row, columns)}: {bound.key} is {shown}; it must be {' and '.join(limits)}"
                )
    return missed


def find_losses(result: Result, baseline: Result, columns: Sequence[Column]) -> list[str]:
    """Returns a sentence for every judged figure that is worse than in the baseline by more than its goal tolerates."""
    losses = []
    now = {_name(row, columns): row for row in result.rows}
    for before in baseline.rows:
        name = _name(before, columns)
        if not before["judged"]:
            continue
        if name not in now:
            losses.append(f"{result.name}: the row {name} of the baseline is missing")
            continue
        for column in columns:
            old, new = before.get(column.key), now[name].get(column.key)
            if column.goal is None or old is None:
                continue
            if new is None:
                losses.append(f"{result.name}, {name}: {column.key} was {old:.4g} and is not known")
                continue
            loss = measure_loss(column.goal, old, new)
            if loss > _TOLERATED.get(column.goal, _TOLERATED_ELSE):
                losses.append(f"{result.name}, {name}: {column.key} was {old:.4g} and is {new:.4g}, a loss of {loss:.0%}")
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


def _name(row: Mapping[str, Any], columns: Sequence[Column]) -> str:
    """Returns the texts that tell a row from the others."""
    return ", ".join(str(row.get(column.key)) for column in columns if column.label)
