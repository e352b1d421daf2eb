"""Real planar lidar logs audited: under the trajectory that a SLAM has corrected, and under the wheels' own."""

from __future__ import annotations

from pathlib import Path

from bench.benchmark import Benchmark, Bound, Row
from bench.measuring.audits import COLUMNS, measure_audit
from bench.measuring.recordings import SHARED, shared

_LOGS = ("intel", "aces")
_TRACKS = {"recording": "corrected", "odometry": "wheels"}


def _measure(out: Path) -> list[Row]:
    rows = []
    for name in _LOGS:
        data = shared(SHARED / "data" / "carmen" / f"{name}-corrected.log.gz")
        rows += [measure_audit(name, data, shown, track, out / name / track) for track, shown in _TRACKS.items()]
    return rows


BENCHMARK = Benchmark(
    what="Two public lidar logs, each under two trajectories.",
    data="real",
    columns=COLUMNS,
    measure=_measure,
    bounds=(Bound("torn", {"trajectory": "corrected"}, most=0.05), Bound("torn", {"trajectory": "wheels"}, least=0.2)),
)
