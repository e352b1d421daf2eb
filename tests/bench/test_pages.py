"""The tables on the pages are those of the committed results, and every benchmark is on a page and can be run."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from bench.benchmark import Benchmark, Bound, Column, Row, label
from bench.benchmarks import BENCHMARKS
from bench.pages import BASELINE, LITERATURE, PAGES, SUMMARY, Result, fill_page, list_blocks, make_result
from bench.timing import Took

PAGE = "Before.\n\n<!-- bench: outing -->\nold\n<!-- /bench -->\n\nAfter.\n"


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A folder with one result."""
    benchmark = Benchmark(
        what="Drives.",
        data="simulated",
        seeds=(1, 2),
        columns=(label("world", "world"), label("run", "run"), Column("drift", "drift [%]", "{:.2f}")),
        measure=lambda out: [
            Row({"world": "kind", "run": "mean", "drift": 0.123456789}),
            Row({"world": "hard", "run": "seed 1", "drift": None}, judged=False),
        ],
    )
    make_result("outing", benchmark, benchmark.measure(tmp_path), Took(160.4, 70.0)).write(tmp_path / "outing.json")
    return tmp_path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_shows_what_the_committed_results_hold(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert text == fill_page(text), f"run `.venv/bin/python {Path('tests/bench/run.py')} --fill`"


def test_no_table_is_typed() -> None:
    text = PAGES[1].read_text(encoding="utf-8")
    outside = re.sub(r"<!-- bench: .*?<!-- /bench -->", "", text, flags=re.DOTALL)
    assert [line for line in outside.splitlines() if line.startswith("|")] == []


def test_every_benchmark_has_its_table_and_its_making_on_the_page() -> None:
    text = PAGES[1].read_text(encoding="utf-8")
    shown = list_blocks(text)
    assert sorted(set(shown)) == sorted([*BENCHMARKS, LITERATURE.stem, SUMMARY.stem])
    assert {name: shown.count(name) for name in BENCHMARKS} == dict.fromkeys(BENCHMARKS, 2)


def test_the_first_table_of_the_page_holds_the_main_figures_beside_the_best_peers() -> None:
    text = PAGES[1].read_text(encoding="utf-8")
    assert list_blocks(text)[0] == SUMMARY.stem
    rows = [line for line in text.split("<!-- /bench -->")[0].splitlines() if line.startswith("|")][2:]
    assert len(rows) == len(json.loads(SUMMARY.read_text(encoding="utf-8"))) and "real" in rows[0]
    cartographer = Result.read(BASELINE / "planar.json").choose({"run": "intel", "method": "Cartographer"})[0]["metres"]
    (intel,) = (row for row in rows if "Intel" in row)
    assert f"{cartographer:.4f} (Cartographer, published)" in intel


def test_committed_results_are_of_benchmarks_that_exist_and_have_their_columns() -> None:
    for path in BASELINE.glob("*.json"):
        assert [column["key"] for column in Result.read(path).columns] == [c.key for c in BENCHMARKS[path.stem].columns]


def test_a_block_is_filled_with_the_table(results: Path) -> None:
    filled = fill_page(PAGE, results)
    assert filled == (
        "Before.\n\n<!-- bench: outing -->\n\n"
        "| world | run    | drift [%] |\n"
        "|-------|--------|-----------|\n"
        "| kind  | mean   | 0.12      |\n"
        "| hard  | seed 1 | -         |\n"
        "\n<!-- /bench -->\n\nAfter.\n"
    )
    assert fill_page(filled, results) == filled


def test_a_block_can_ask_for_some_rows(results: Path) -> None:
    filled = fill_page(PAGE.replace("outing -->", "outing run=mean -->"), results)
    assert "| world | drift [%] |\n" in filled and "hard" not in filled
    with pytest.raises(ValueError, match="outing has no row"):
        fill_page(PAGE.replace("outing -->", "outing run=none -->"), results)


def test_a_block_can_ask_for_some_columns(results: Path) -> None:
    filled = fill_page(PAGE.replace("outing -->", "outing run=mean only=drift -->"), results)
    assert "| drift [%] |\n|-----------|\n| 0.12      |\n" in filled and "kind" not in filled


def test_figures_that_miss_a_bound_are_listed_below_the_table(results: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bounds = (Bound("drift", {"run": "mean"}, most=0.1), Bound("drift", {"run": "seed 2"}, most=0.1))
    benchmark = Benchmark(
        what="Drives.", data="simulated", columns=(label("world", "world"), label("run", "run")), measure=list, bounds=bounds
    )
    monkeypatch.setitem(BENCHMARKS, "outing", benchmark)
    assert "| hard  | seed 1 | -         |\n\nBounds that were set before measuring and are missed:\n\n" in fill_page(
        PAGE, results
    )
    assert "- outing, kind, mean: drift is 0.1235; it must be at most 0.1." in fill_page(PAGE, results)
    assert "- outing: no row has seed 2, whose drift has a bound." in fill_page(PAGE, results)
    by_mean, by_seed = (
        fill_page(PAGE.replace("outing -->", f"outing {word} -->"), results) for word in ("run=mean", "world=hard")
    )
    assert by_mean.count("\n- ") == 1 and "missed" not in by_seed
    assert fill_page(PAGE.replace("outing -->", "outing world=hard bounds=all -->"), results).count("\n- ") == 2


def test_a_block_can_ask_how_the_table_was_made(results: Path) -> None:
    filled = fill_page(PAGE.replace("outing -->", "outing made -->"), results)
    assert "`.venv/bin/python tests/bench/run.py outing` (simulated data, seeds 1, 2; mqslam " in filled
    assert "; 3 min, 70 s of processor time, " in filled


def test_a_table_that_has_not_been_measured_says_so(tmp_path: Path) -> None:
    assert "These figures have not been measured yet." in fill_page(PAGE, tmp_path)


def test_a_change_of_a_result_shows_on_the_page(results: Path) -> None:
    filled = fill_page(PAGE, results)
    path = results / "outing.json"
    path.write_text(path.read_text(encoding="utf-8").replace("0.123457", "0.2"), encoding="utf-8")
    assert fill_page(filled, results) != filled
