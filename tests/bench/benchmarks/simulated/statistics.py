"""How kind the simulated worlds are: the statistics of power and returns in the city."""

from __future__ import annotations

from pathlib import Path

from bench.benchmark import Benchmark, Row
from bench.measuring.realism import make_columns, measure_realism
from bench.measuring.recordings import simulate_city

_SEEDS = (1, 2)
_RECORDINGS = {f"{world}{seed}": (world, seed) for world in ("kind", "hard") for seed in _SEEDS}


def _measure(out: Path) -> list[Row]:
    return measure_realism({key: simulate_city(world, seed) for key, (world, seed) in _RECORDINGS.items()})


BENCHMARK = Benchmark(
    what="Statistics of power and returns in the city.",
    data="simulated",
    seeds=_SEEDS,
    columns=make_columns({key: f"{world}, seed {seed}" for key, (world, seed) in _RECORDINGS.items()}),
    measure=_measure,
)
