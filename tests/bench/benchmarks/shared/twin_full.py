"""Whole runs of the city twin: drift, every loop against the truth, speed and memory."""

from __future__ import annotations

from pathlib import Path

from bench.benchmark import Benchmark, Bound, Row
from bench.measuring.recordings import twin
from bench.measuring.whole_runs import COLUMNS, measure_run

_RUNS = (("kaist01", 1), ("kaist02", 2))  # run, seed


def _measure(out: Path) -> list[Row]:
    return [
        measure_run(f"{name}, {world}", twin(name, world, seed), out) for world in ("kind", "hard") for name, seed in _RUNS
    ]


BENCHMARK = Benchmark(
    what="Whole runs of the city twin, about 6 km each, by radar alone.",
    data="twin",
    seeds=(1, 2),
    columns=COLUMNS,
    measure=_measure,
    bounds=(Bound("worst_m", {}, most=1.0), Bound("worst_deg", {}, most=1.0), Bound("tied", {}, least=0.6)),
)
