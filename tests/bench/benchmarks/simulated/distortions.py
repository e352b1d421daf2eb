"""Which wrong trajectories an audit tells from right ones."""

from __future__ import annotations

from pathlib import Path

from bench.benchmark import Benchmark, Row
from bench.measuring.false_maps import BOUNDS, COLUMNS, WORLDS, measure_distortions
from bench.measuring.recordings import simulate_short_city

_SEEDS = (11, 12, 13, 14)  # of drives that `heading` measures too


def _measure(out: Path) -> list[Row]:
    return measure_distortions({world: [simulate_short_city(world, seed) for seed in _SEEDS] for world in WORLDS})


BENCHMARK = Benchmark(
    what="Cities of a minute, audited under their true trajectories and under wrong ones: the share that is called bad.",
    data="simulated",
    seeds=_SEEDS,
    columns=COLUMNS,
    measure=_measure,
    bounds=BOUNDS,
)
