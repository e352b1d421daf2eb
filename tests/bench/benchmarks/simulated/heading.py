"""Whether headings drift to one side: their drift over ten short drives, which must be zero within its error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.measuring.commands import FRONT_ENDS, OURS, compare
from bench.measuring.recordings import TRUTH, simulate_short_city
from bench.measuring.scorer import score

_SEEDS = tuple(range(11, 21))
_COMPARED = ("psi", "kiss_icp")


def _measure(out: Path) -> list[Row]:
    return [row for world in ("kind", "hard") for row in _measure_world(world, out)]


def _measure_world(world: str, out: Path) -> list[Row]:
    drifts: dict[str, list[float]] = {name: [] for name in _COMPARED}
    for seed in _SEEDS:
        data = simulate_short_city(world, seed)
        compared = compare(data, out / data.name, _COMPARED, back_end=False)
        for name, values in drifts.items():
            values.append(score(compared / name / "odometry.tum", data / TRUTH).heading_deg_per_km)
    rows = []
    for name, values in drifts.items():
        error = float(np.std(values, ddof=1) / np.sqrt(len(values)))
        mean = float(np.mean(values))
        cells: dict[str, Cell] = {
            "world": world,
            "front_end": FRONT_ENDS[name],
            "mean": mean,
            "error": error,
            "errors_off": abs(mean) / error,
            "rms": float(np.sqrt(np.mean(np.square(values)))),
        }
        rows.append(Row(cells, judged=name == "psi"))
    return rows


BENCHMARK = Benchmark(
    what="Heading drift over ten drives of a minute each, before loops; counter-clockwise is positive.",
    data="simulated",
    seeds=_SEEDS,
    columns=(
        label("world", "world"),
        label("front_end", "front end"),
        Column("mean", "mean [deg/km]", "{:+.3f}"),
        Column("error", "its standard error", "{:.3f}"),
        Column("errors_off", "mean over its error", "{:.1f}"),
        Column("rms", "RMS [deg/km]", "{:.3f}", Goal.LOW),
    ),
    measure=_measure,
    bounds=(Bound("errors_off", {"front_end": OURS}, most=2.0),),
)
