"""Whole runs through simulated cities: drift, every loop against the truth, speed and memory."""

from __future__ import annotations

from pathlib import Path

from bench.benchmark import Benchmark, Bound, Row
from bench.measuring.recordings import simulate_city
from bench.measuring.whole_runs import COLUMNS, measure_run

_SEED = 1


def _measure(out: Path) -> list[Row]:
    return [measure_run(f"{world}, seed {_SEED}", simulate_city(world, _SEED), out) for world in ("kind", "hard")]


BENCHMARK = Benchmark(
    what="Whole runs of two kilometres with default settings, by radar alone.",
    data="simulated",
    seeds=(_SEED,),
    columns=COLUMNS,
    measure=_measure,
    bounds=(
        Bound("worst_m", {}, most=1.0),
        Bound("worst_deg", {}, most=1.0),
        Bound("tied", {}, least=0.6),
        Bound("peak_mb", {}, most=2000.0),
    ),
)
