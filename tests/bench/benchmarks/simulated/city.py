"""All front ends on drives of two kilometres through simulated cities, before and after loops."""

from __future__ import annotations

from pathlib import Path

from bench.benchmark import Benchmark, Bound, Row
from bench.measuring.commands import OURS
from bench.measuring.peers import COLUMNS, MEAN, Run, average, measure_peers
from bench.measuring.recordings import simulate_city

_SEEDS = {"kind": (1, 2), "hard": (1, 2, 3, 4)}


def _measure(out: Path) -> list[Row]:
    rows = [
        row
        for world, seeds in _SEEDS.items()
        for seed in seeds
        for row in measure_peers(Run(world, f"seed {seed}", simulate_city(world, seed)), out)
    ]
    return [*rows, *average(rows, tuple(_SEEDS))]


_HARD = {"world": "hard", "front_end": OURS}
_HARD_MEAN = {**_HARD, "run": MEAN}

BENCHMARK = Benchmark(
    what="Drives of two kilometres, by radar alone: every front end gets the same returns and the same back end.",
    data="simulated",
    seeds=_SEEDS["hard"],
    columns=COLUMNS,
    measure=_measure,
    bounds=(
        Bound("of_rival", _HARD, most=1.0),
        Bound("of_rival", _HARD_MEAN, most=0.25),
        Bound("drift", _HARD_MEAN, most=0.13),
        Bound("turn", _HARD_MEAN, most=0.045),
        Bound("speed", _HARD, most=0.12),
        Bound("ate_after", _HARD, most=0.10),
        Bound("nees", _HARD_MEAN, most=1.6),
        Bound("nees_poses", _HARD_MEAN, least=0.6, most=1.6),
        Bound("nees_alone", _HARD_MEAN, least=0.2, most=1.6),
        Bound("nees_alone", _HARD, most=2.5),
    ),
)
