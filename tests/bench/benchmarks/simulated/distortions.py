"""Which wrong trajectories an audit tells from right ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.measuring.distortions import DISTORTIONS, distort
from bench.measuring.recordings import TRUTH, simulate_short_city
from bench.measuring.scorer import read_trajectory
from bench.measuring.verdicts import count_bad, judge_tracks

_SEEDS = (11, 12, 13, 14)  # of drives that `heading` measures too
_WORLDS = ("kind", "hard")


def _measure(out: Path) -> list[Row]:
    verdicts: dict[str, dict[str, list[str]]] = {name: {world: [] for world in _WORLDS} for name in DISTORTIONS}
    for world in _WORLDS:
        for seed in _SEEDS:
            data = simulate_short_city(world, seed)
            truth = read_trajectory(data / TRUTH)
            tracks = {name: distort(truth, distortion) for name, distortion in DISTORTIONS.items()}
            for name, verdict in judge_tracks(data, tracks):
                verdicts[name][world].append(verdict)
    return [_make_row(name, of_worlds) for name, of_worlds in verdicts.items()]


def _make_row(name: str, verdicts: Mapping[str, Sequence[str]]) -> Row:
    """Returns the row of a distortion, given the verdicts on the drives of each world."""
    cells: dict[str, Cell] = {"distortion": name}
    for world, given in verdicts.items():
        cells[world] = count_bad(given) / len(given)
        cells[f"{world} verdicts"] = ", ".join(given)
    return Row(cells, judged=name != _RIGHT)


_RIGHT = next(iter(DISTORTIONS))

BENCHMARK = Benchmark(
    what="Cities of a minute, audited under their true trajectories and under wrong ones: the share that is called bad.",
    data="simulated",
    seeds=_SEEDS,
    columns=(
        label("distortion", "distortion"),
        *(
            column
            for world in _WORLDS
            for column in (Column(world, world, "{:.0%}", Goal.HIGH), Column(f"{world} verdicts", "verdicts", "{}"))
        ),
    ),
    measure=_measure,
    bounds=tuple(Bound(world, {"distortion": _RIGHT}, most=0.0) for world in _WORLDS),
)
