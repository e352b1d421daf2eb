"""All front ends on the first scans of the city twin, before loops."""

from __future__ import annotations

from pathlib import Path

from bench.benchmark import Benchmark, Bound, Row
from bench.measuring.commands import OURS
from bench.measuring.peers import COLUMNS, MEAN, Run, average, measure_peers
from bench.measuring.recordings import twin

_RUNS = (  # run, seed, world, scans
    ("kaist01", 1, "kind", 800),
    ("kaist02", 2, "kind", 800),
    ("kaist01", 1, "hard", 400),
    ("kaist02", 2, "hard", 400),
)


def _measure(out: Path) -> list[Row]:
    rows = [
        row
        for name, seed, world, scans in _RUNS
        for row in measure_peers(Run(world, f"{name}, first {scans}", twin(name, world, seed, scans)), out, back_end=False)
    ]
    return [*rows, *average(rows, ("kind", "hard"))]


BENCHMARK = Benchmark(
    what="The first scans of the city twin, by radar alone: every front end gets the same returns.",
    data="twin",
    seeds=(1, 2),
    columns=tuple(column for column in COLUMNS if column.key not in ("ate_after", "loops", "nees_poses")),
    measure=_measure,
    bounds=(
        Bound("of_rival", {"front_end": OURS}, most=1.0),
        Bound("nees_alone", {"front_end": OURS}, most=2.5),
        Bound("nees_alone", {"front_end": OURS, "run": MEAN}, least=0.2, most=1.6),
    ),
)
