"""What an hour of radar costs on one core, stage by stage."""

from __future__ import annotations

from pathlib import Path

from bench.benchmark import Benchmark, Column, Row, label
from bench.measuring.commands import read_json, run
from bench.measuring.recordings import simulate_city

_SEED = 1
_STAGES = ("read", "detect", "windows", "loops", "optimise", "render", "check", "total")


def _measure(out: Path) -> list[Row]:
    spent: dict[str, dict[str, float]] = {}
    for world in ("kind", "hard"):
        data = simulate_city(world, _SEED)
        summary = read_json(run(data, out / data.name, "--jobs", "1") / "summary.json")
        hours = summary["dataset"]["duration_s"] / 3600.0
        spent[world] = {stage: summary["runtime_s"][stage] / hours for stage in _STAGES}
    return [
        Row(
            {"stage": stage}
            | {world: seconds[stage] for world, seconds in spent.items()}
            | {f"{world}_share": seconds[stage] / seconds["total"] for world, seconds in spent.items()},
            judged=False,
        )
        for stage in _STAGES
    ]


BENCHMARK = Benchmark(
    what="Seconds on one core per hour of radar (14,400 scans).",
    data="simulated",
    seeds=(_SEED,),
    columns=(
        label("stage", "stage"),
        Column("kind", "kind [s]", "{:.0f}"),
        Column("kind_share", "share", "{:.1%}"),
        Column("hard", "hard [s]", "{:.0f}"),
        Column("hard_share", "share", "{:.1%}"),
    ),
    measure=_measure,
)
