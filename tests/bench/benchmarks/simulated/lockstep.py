"""A queue of vehicles that moves in exact lockstep with the own one: who mistakes it for the world loses the way."""

from __future__ import annotations

from pathlib import Path

from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.measuring.commands import FRONT_ENDS, OURS, compare
from bench.measuring.recordings import TRUTH, simulate
from bench.measuring.scorer import score

_DURATION_S = 90.0
_SEEDS = (1, 2, 3, 4, 5)


def _measure(out: Path) -> list[Row]:
    rows = []
    for seed in _SEEDS:
        data = simulate("queue", "hard", seed, _DURATION_S)
        compared = compare(data, out / data.name, tuple(FRONT_ENDS), back_end=False)
        for name, shown in FRONT_ENDS.items():
            cells: dict[str, Cell] = {"run": f"seed {seed}", "front_end": shown}
            track = compared / name / "odometry.tum"
            if track.exists():
                errors = score(track, data / TRUTH)
                cells |= {"followed": errors.followed, "drift": errors.drift_percent, "speed": errors.rpe_v_rms}
            rows.append(Row(cells, judged=name == "psi"))
    return rows


BENCHMARK = Benchmark(
    what="A minute among vehicles that move in exact lockstep with the own one, before loops.",
    data="simulated",
    seeds=_SEEDS,
    columns=(
        label("run", "run"),
        label("front_end", "front end"),
        Column("followed", "steps less than 1 m/s off", "{:.1%}", Goal.HIGH),
        Column("drift", "drift [%]", "{:.3f}"),
        Column("speed", "speed RMS [m/s]", "{:.3f}"),
    ),
    measure=_measure,
    bounds=(Bound("followed", {"front_end": OURS}, least=0.99),),
)
