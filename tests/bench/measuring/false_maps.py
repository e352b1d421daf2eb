"""How many of the distortions of a right trajectory an audit calls bad, in each of several worlds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.benchmark import Bound, Cell, Column, Goal, Row, label
from bench.measuring.distortions import DISTORTIONS, distort
from bench.measuring.recordings import TRUTH
from bench.measuring.scorer import read_trajectory
from bench.measuring.verdicts import count_bad, judge_tracks

WORLDS = ("kind", "hard")
_RIGHT = next(iter(DISTORTIONS))
COLUMNS = (
    label("distortion", "distortion"),
    *(
        column
        for world in WORLDS
        for column in (Column(world, world, "{:.0%}", Goal.HIGH), Column(f"{world} verdicts", "verdicts", "{}"))
    ),
)
BOUNDS = tuple(Bound(world, {"distortion": _RIGHT}, most=0.0) for world in WORLDS)


def measure_distortions(drives: Mapping[str, Sequence[Path]]) -> list[Row]:
    """Returns a row for each distortion, given the drives of each world."""
    verdicts: dict[str, dict[str, list[str]]] = {name: {world: [] for world in drives} for name in DISTORTIONS}
    for world, of_world in drives.items():
        for data in of_world:
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
