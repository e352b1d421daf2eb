"""What an hour of radar costs on one core, stage by stage."""

from __future__ import annotations

from pathlib import Path

from bench.benchmark import Benchmark, Column, Row, label
from bench.measuring.commands import read_json, run
from bench.measuring.recordings import simulate_city

_SEED = 1
_STAGES = ("read", "detect", "windows", "loops", "optimise", "render", "check", "total")


def _measure(out: Path) -> list[Row]:
    data = simulate_city("hard", _SEED)
    summary = read_json(run(data, out / data.name, "--jobs", "1") / "summary.json")
    hours, spent = summary["dataset"]["duration_s"] / 3600.0, summary["runtime_s"]
    return [
        Row({"stage": stage, "seconds": spent[stage] / hours, "share": spent[stage] / spent["total"]}, judged=False)
        for stage in _STAGES
    ]


BENCHMARK = Benchmark(
    what="Seconds on one core per hour of radar (14,400 scans) of the hard city.",
    data="simulated",
    seeds=(_SEED,),
    columns=(
        label("stage", "stage"),
        Column("seconds", "[s] per hour of radar", "{:.0f}"),
        Column("share", "share", "{:.1%}"),
    ),
    measure=_measure,
)
