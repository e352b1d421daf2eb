"""Which wrong trajectories an audit tells from right ones."""

from __future__ import annotations

from pathlib import Path

from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.measuring.commands import audit
from bench.measuring.distortions import DISTORTIONS, Distortion, distort
from bench.measuring.recordings import TRUTH, simulate_short_city
from bench.measuring.scorer import read_trajectory
from evo.tools import file_interface

_SEEDS = (11, 12)  # of drives that `heading` measures too
_WORLDS = ("kind", "hard")
_BAD = ("warn", "fail")


def _measure(out: Path) -> list[Row]:
    return [_judge(name, distortion, out / str(k)) for k, (name, distortion) in enumerate(DISTORTIONS.items())]


def _judge(name: str, distortion: Distortion, out: Path) -> Row:
    """Returns in how many drives of each world an audit calls a distortion bad."""
    cells: dict[str, Cell] = {"distortion": name}
    for world in _WORLDS:
        verdicts = []
        for seed in _SEEDS:
            data, folder = simulate_short_city(world, seed), out / f"{world}{seed}"
            folder.mkdir(parents=True)
            wrong = folder / "wrong.tum"
            file_interface.write_tum_trajectory_file(str(wrong), distort(read_trajectory(data / TRUTH), distortion))
            verdicts.append(audit(data, wrong, folder / "audit")["verdict"]["status"])
        cells[world] = sum(verdict in _BAD for verdict in verdicts) / len(verdicts)
        cells[f"{world} verdicts"] = ", ".join(verdicts)
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
