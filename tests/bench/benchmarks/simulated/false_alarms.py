"""How often the verdict on a good map is bad: under the true trajectories of many drives, and under those of runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label
from bench.measuring.commands import audit, read_json, run
from bench.measuring.recordings import simulate_short_city
from bench.measuring.verdicts import count_bad

_SEEDS = tuple(range(11, 61))
_WORLDS = ("kind", "hard")
_TRACKS = ("true", "optimised")


def _measure(out: Path) -> list[Row]:
    return [row for world in _WORLDS for row in _measure_world(world, out)]


def _measure_world(world: str, out: Path) -> list[Row]:
    given: dict[str, list[str]] = {name: [] for name in _TRACKS}
    for seed in _SEEDS:
        data = simulate_short_city(world, seed)
        given["true"].append(audit(data, "ground_truth", out / data.name / "true")["verdict"]["status"])
        given["optimised"].append(read_json(run(data, out / data.name / "run") / "summary.json")["verdict"]["status"])
    return [_make_row(world, name, verdicts) for name, verdicts in given.items()]


def _make_row(world: str, track: str, verdicts: Sequence[str]) -> Row:
    return Row(
        {
            "world": world,
            "track": track,
            "drives": len(verdicts),
            "bad": count_bad(verdicts),
            "not_judged": verdicts.count("not judged"),
        }
    )


BENCHMARK = Benchmark(
    what="Cities of a minute, audited under their true trajectories, and run: the number of drives whose map is called bad.",
    data="simulated",
    seeds=_SEEDS,
    columns=(
        label("world", "world"),
        label("track", "trajectory"),
        Column("drives", "drives", "{:.0f}"),
        Column("bad", "called bad", "{:.0f}", Goal.LOW),
        Column("not_judged", "not judged", "{:.0f}"),
    ),
    measure=_measure,
    bounds=tuple(Bound("bad", {"world": world}, most=1.0) for world in _WORLDS),
)
