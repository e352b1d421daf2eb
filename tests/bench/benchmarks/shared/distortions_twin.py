"""Which wrong trajectories through the city twin an audit tells from right ones."""

from __future__ import annotations

from pathlib import Path

from bench.benchmark import Benchmark, Row
from bench.measuring.false_maps import BOUNDS, COLUMNS, WORLDS, measure_distortions
from bench.measuring.recordings import twin

_SCANS = 240  # a minute
_DRIVES = (("kaist01", 3, 0), ("kaist01", 4, 1500), ("kaist02", 5, 500), ("kaist02", 6, 2000))  # run, seed, first scan


def _measure(out: Path) -> list[Row]:
    return measure_distortions(
        {world: [twin(name, world, seed, _SCANS, start) for name, seed, start in _DRIVES] for world in WORLDS}
    )


BENCHMARK = Benchmark(
    what="Minutes of the city twin, audited under true trajectories and under wrong ones: the share that is called bad.",
    data="twin",
    seeds=tuple(seed for _, seed, _ in _DRIVES),
    columns=COLUMNS,
    measure=_measure,
    bounds=BOUNDS,
)
