"""What more workers of a cluster gain: a batch of short runs on one and on two workers of this machine."""

from __future__ import annotations

import time
from pathlib import Path

from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label
from bench.measuring.commands import batch
from bench.measuring.recordings import simulate_short_city

_SEED = 11  # of a drive that `heading` measures too
_RUNS = 4
_WORKERS = (1, 2)


def _measure(out: Path) -> list[Row]:
    data = simulate_short_city("kind", _SEED)
    runs = out / "runs.yaml"
    lines = [f"  - {{data: {data}, name: run{k}, odometry: none}}" for k in range(_RUNS)]
    runs.write_text("\n".join(["runs:", *lines, ""]), encoding="utf-8")
    spent = []
    for workers in _WORKERS:
        begin = time.perf_counter()
        batch(runs, out / f"workers{workers}", "--cluster", f"local:{workers}")
        spent.append(time.perf_counter() - begin)
    return [
        Row({"workers": str(workers), "seconds": seconds, "share": seconds / spent[0]}, judged=workers > 1)
        for workers, seconds in zip(_WORKERS, spent, strict=True)
    ]


BENCHMARK = Benchmark(
    what="A batch of four runs of a minute each on a local cluster, the whole command.",
    data="simulated",
    seeds=(_SEED,),
    columns=(
        label("workers", "workers"),
        Column("seconds", "time [s]", "{:.0f}"),
        Column("share", "of one worker's time", "{:.2f}", Goal.FAST),
    ),
    measure=_measure,
    bounds=(Bound("share", {"workers": "2"}, most=0.72),),
)
