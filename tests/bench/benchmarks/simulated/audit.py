"""Maps of a simulated city audited: under the true trajectory, and under KISS-ICP's without loops."""

from __future__ import annotations

from pathlib import Path

from bench.benchmark import Benchmark, Bound, Row
from bench.measuring.audits import COLUMNS, measure_audit
from bench.measuring.commands import compare
from bench.measuring.recordings import simulate_city

_SEED = 1
_TRUE = "true"


def _measure(out: Path) -> list[Row]:
    rows = []
    for world in ("kind", "hard"):
        data = simulate_city(world, _SEED)
        rival = compare(data, out / data.name, ("kiss_icp",), back_end=False) / "kiss_icp" / "trajectory.tum"
        rows.append(measure_audit(world, data, _TRUE, "ground_truth", out / world / "true"))
        rows.append(measure_audit(world, data, "KISS-ICP, no loops", rival, out / world / "rival"))
    return rows


BENCHMARK = Benchmark(
    what="The audit of a right map, and of one without loops.",
    data="simulated",
    seeds=(_SEED,),
    columns=COLUMNS,
    measure=_measure,
    bounds=(Bound("torn", {"trajectory": _TRUE, "data": "kind"}, most=0.02),),
)
