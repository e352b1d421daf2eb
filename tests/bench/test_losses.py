"""A figure that lost too much against the baseline is named, and so is one beyond its bound."""

from __future__ import annotations

from typing import Any

import pytest
from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label, measure_loss

COLUMNS = (
    label("run", "run"),
    Column("drift", "drift [%]", goal=Goal.LOW),
    Column("tied", "tied", goal=Goal.HIGH),
    Column("nees", "NEES/3", goal=Goal.ONE),
    Column("share", "of KISS-ICP's time", goal=Goal.FAST),
    Column("loops", "loops"),
    Column("verdict", "verdict", "{}"),
)
BEFORE: dict[str, Cell] = {
    "run": "hard", "drift": 0.2, "tied": 0.8, "nees": 1.25, "share": 2.0, "loops": 40.0, "verdict": "pass"
}  # fmt: skip


def listed(*rows: Row) -> list[dict[str, Any]]:
    """Returns rows as a result holds them."""
    return [{"judged": row.judged, **row.cells} for row in rows]


def benchmark(*bounds: Bound) -> Benchmark:
    return Benchmark(what="", data="simulated", columns=COLUMNS, measure=lambda out: [], bounds=bounds)


def losses(*, judged: bool = True, **now: Cell) -> list[str]:
    """Returns the losses of a result against the baseline, given the cells that differ."""
    return benchmark().find_losses("city", listed(Row(BEFORE | now)), listed(Row(BEFORE, judged)))


def test_the_same_figures_are_no_loss() -> None:
    assert losses() == []


@pytest.mark.parametrize(
    ("key", "little", "much"),
    [
        ("drift", 0.2 * 1.04, 0.2 * 1.06),
        ("tied", 0.8 / 1.04, 0.8 / 1.06),
        ("nees", 1.25 * 1.04, 1.25 * 1.06),
        ("nees", 0.8 / 1.04, 0.8 / 1.06),  # 0.8 is as far from one as 1.25
        ("share", 2.0 * 1.24, 2.0 * 1.26),
    ],
)
def test_a_little_worse_is_tolerated_and_more_is_named(key: str, little: float, much: float) -> None:
    assert losses(**{key: little}) == []
    (sentence,) = losses(**{key: much})
    assert sentence.startswith(f"city, hard: {key} was ") and "a loss of" in sentence


@pytest.mark.parametrize(("key", "better"), [("drift", 0.1), ("tied", 1.0), ("nees", 1.0), ("share", 0.5)])
def test_what_got_better_is_no_loss(key: str, better: float) -> None:
    assert losses(**{key: better}) == []


def test_columns_without_a_goal_and_rows_of_others_may_change() -> None:
    assert losses(loops=1.0, verdict="fail") == []
    assert losses(judged=False, drift=9.0) == []


def test_a_row_or_a_figure_that_is_missing_is_a_loss() -> None:
    assert benchmark().find_losses("city", [], listed(Row(BEFORE))) == ["city: the row hard of the baseline is missing"]
    assert losses(drift=None) == ["city, hard: drift was 0.2 and is not known"]


def test_an_error_that_was_zero_may_not_come_back() -> None:
    assert measure_loss(Goal.LOW, 0.0, 0.0) == 0.0
    assert measure_loss(Goal.LOW, 0.0, 1e-6) == float("inf")
    assert measure_loss(Goal.HIGH, 0.5, 0.0) == float("inf")


@pytest.mark.parametrize(
    ("bound", "sentences"),
    [
        (Bound("drift", {"run": "hard"}, most=0.2), []),
        (
            Bound("drift", {"run": "hard"}, least=0.1, most=0.19),
            ["city, hard: drift is 0.2; it must be at least 0.1 and at most 0.19"],
        ),
        (Bound("drift", {}, most=1.0), ["city, kind: drift is not known; it must be at most 1"]),
        (Bound("drift", {"run": "soft"}, most=1.0), ["city: no row has soft, whose drift has a bound"]),
    ],
)
def test_a_figure_beyond_its_bound_is_named_and_a_bound_that_concerns_no_row(bound: Bound, sentences: list[str]) -> None:
    rows = listed(Row(BEFORE), Row(BEFORE | {"run": "kind", "drift": None}))
    assert benchmark(bound).find_missed("city", rows) == sentences
