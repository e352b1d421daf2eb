"""The statistics of power and returns of real radar, and of the city twin."""

from __future__ import annotations

from pathlib import Path

from bench.benchmark import Benchmark, Row
from bench.measuring.realism import make_columns, measure_realism
from bench.measuring.recordings import SHARED, shared, twin

_FRAMES = 400


def _measure(out: Path) -> list[Row]:
    recordings = {"real": shared(SHARED / "data" / "oxford_tiny")}
    recordings |= {world: twin("kaist01", world, 1, _FRAMES) for world in ("kind", "hard")}
    return measure_realism(recordings)


BENCHMARK = Benchmark(
    what="Statistics of power and returns of eleven real scans, and of the first 400 scans of the twin's kaist01.",
    data="real",
    seeds=(1,),
    columns=make_columns({"real": "real Oxford", "kind": "twin, kind", "hard": "twin, hard"}),
    measure=_measure,
)
