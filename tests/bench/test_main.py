"""The command measures what it is told, and its exit code says whether a figure got worse."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from bench import main
from bench.benchmark import Benchmark, Bound, Column, Goal, MissingData, Row, label
from bench.benchmarks import BENCHMARKS
from bench.pages import BASELINE, Result

Run = Callable[..., int]


def make_benchmark(drift: float) -> Benchmark:
    """Returns a benchmark of one row."""
    return Benchmark(
        what="A drive.",
        data="simulated",
        columns=(label("run", "run"), Column("drift", "drift [%]", goal=Goal.LOW)),
        measure=lambda out: [Row({"run": "hard", "drift": drift})],
        bounds=(Bound("drift", {}, most=1.0),),
    )


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Runs the command over one benchmark, `drive`, whose drift is given; its folders are temporary."""
    monkeypatch.setattr(main, "BASELINE", tmp_path / "baseline")
    monkeypatch.setattr(main, "write_pages", lambda: (tmp_path / "pages").touch())

    def call(benchmark: Benchmark | float, *words: str) -> int:
        made = make_benchmark(benchmark) if isinstance(benchmark, float) else benchmark
        monkeypatch.setattr(main, "BENCHMARKS", {"drive": made})
        monkeypatch.setattr(sys, "argv", ["run.py", *words, "--out", str(tmp_path / "out")])
        return main.main()

    return call


def test_a_result_holds_what_is_needed_to_make_it_again(run: Run, tmp_path: Path) -> None:
    assert run(0.2) == 0
    result = Result.read(tmp_path / "out" / "drive.json")
    assert result.rows == [{"judged": True, "run": "hard", "drift": 0.2}]
    assert result.command.endswith("run.py drive") and result.version and result.machine["cores"] > 0
    assert not (tmp_path / "baseline").exists() and not (tmp_path / "pages").exists()


def test_a_loss_of_six_percent_fails_and_one_of_four_does_not(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(0.2, "--write") == 0
    assert run(0.2 * 1.04) == 0
    assert run(0.2 * 1.06) == 1
    assert "drive, hard: drift was 0.2 and is 0.212, a loss of 6%" in capsys.readouterr().out


def test_a_new_baseline_takes_the_loss_and_fills_the_pages(run: Run, tmp_path: Path) -> None:
    assert run(0.2, "--write") == 0
    assert run(0.3, "--write") == 0
    assert run(0.3) == 0
    assert (tmp_path / "pages").exists()


def test_a_missed_bound_fails_without_a_baseline_too(run: Run) -> None:
    assert run(1.1) == 1
    assert run(1.1, "--write") == 1


def raising(error: Exception) -> Benchmark:
    """Returns a benchmark that cannot be measured."""

    def measure(out: Path) -> list[Row]:
        raise error

    return Benchmark(what="", data="twin", columns=(label("run", "run"),), measure=measure)


def test_a_benchmark_without_its_data_is_skipped_with_the_reason(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(raising(MissingData("the twin is not on this machine"))) == 0
    assert "SKIPPED: the twin is not on this machine" in capsys.readouterr().out


def test_a_benchmark_that_breaks_fails_the_command(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(raising(RuntimeError("no"))) == 1
    assert "drive failed: no" in capsys.readouterr().out


def test_a_study_runs_only_if_it_is_named_or_all_are_asked_for(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    study = replace(make_benchmark(0.2), study=True)
    for words, runs in (((), False), (("drive",), True), (("--all",), True)):
        assert run(study, *words) == 0 and ("== drive" in capsys.readouterr().out) is runs


def test_what_runs_by_default_takes_half_an_hour_at_most() -> None:
    took = [Result.read(BASELINE / f"{name}.json").took for name, benchmark in BENCHMARKS.items() if not benchmark.study]
    assert len(took) > 10 and sum(one["processor_s"] for one in took) < 1800.0


def test_an_unknown_benchmark_is_refused_with_those_that_exist(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        run(0.2, "drve")
    assert "no benchmark drve; there are drive" in capsys.readouterr().err


@pytest.mark.parametrize("benchmark", BENCHMARKS.values(), ids=BENCHMARKS)
def test_bounds_are_of_columns_that_the_benchmark_has(benchmark: Benchmark) -> None:
    keys = {column.key for column in benchmark.columns}
    labels = {column.key for column in benchmark.columns if column.label}
    assert labels
    for bound in benchmark.bounds:
        assert bound.key in keys and set(bound.where) <= labels
