"""Front ends on the same returns of a recording, before loops: a row each."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.commands import FRONT_ENDS, OURS, RIVAL, compare, run_without_loops
from bench.recordings import TRUTH, simulate, simulate_short_city, twin
from bench.scorer import measure_nees, measure_pose_nees, score

_MEAN = "mean"
_WORLDS = ("kind", "hard")
_COLUMNS = (
    label("world", "world"),
    label("run", "run"),
    label("front_end", "front end"),
    Column("drift", "drift [%]", "{:.3f}", Goal.LOW),
    Column("turn", "[deg/100 m]", "{:.3f}", Goal.LOW),
    Column("speed", "speed RMS [m/s]", "{:.3f}", Goal.LOW),
    Column("ate", "ATE [m]", "{:.2f}", Goal.LOW),
    Column("nees", "NEES/3", "{:.2f}", Goal.ONE),
    Column("nees_median", "its median", "{:.2f}"),
    Column("nees_alone", "without loops", "{:.2f}"),
    Column("of_rival", "of KISS-ICP's drift", "{:.2f}", Goal.LOW),
)


class _Run(NamedTuple):
    """A recording to compare on: world and name as the table shows them, and a function that finds the data."""

    world: str
    name: str
    find: Callable[[], Path]


def _measure(runs: Iterable[_Run], out: Path) -> list[Row]:
    """Returns a row per run and front end, and the mean of each world, of which psi's is judged."""
    rows = [cells for run in runs for cells in _measure_run(run, out)]
    means: list[Row] = []
    for world in _WORLDS:
        names = dict.fromkeys(cells["front_end"] for cells in rows if cells["world"] == world)
        of_world: list[dict[str, Cell]] = []
        for name in names:
            alike = [cells for cells in rows if (cells["world"], cells["front_end"]) == (world, name)]
            numbers = {c.key: _mean([cells.get(c.key) for cells in alike]) for c in _COLUMNS if not c.label}
            of_world.append({"world": world, "run": _MEAN, "front_end": name, **numbers})
        _relate(of_world)
        means += [Row(cells, judged=cells["front_end"] == OURS) for cells in of_world]
    return [*(Row(cells, judged=False) for cells in rows), *means]  # chance decides much of a single run


def _measure_run(run: _Run, out: Path) -> list[dict[str, Cell]]:
    """Returns the cells of every front end on a recording, before loops."""
    data = run.find()
    truth = data / TRUTH
    folder = compare(data, out / data.name, tuple(FRONT_ENDS), back_end=False)
    rows = []
    for name, shown in FRONT_ENDS.items():
        cells: dict[str, Cell] = {"world": run.world, "run": run.name, "front_end": shown}
        own = folder / name
        if own.is_dir():
            cells |= _score(own / "odometry.tum", truth)
            cells |= _judge_motions(own / "measurements.csv", own / "trajectory.tum", truth)
        if shown == OURS:
            alone = run_without_loops(data, out / f"{data.name}-without-loops")
            cells["nees_alone"] = measure_pose_nees(alone, truth)
        rows.append(cells)
    _relate(rows)
    return rows


def _score(odometry: Path, truth: Path) -> dict[str, Cell]:
    """Returns the cells of a track before loops."""
    errors = score(odometry, truth)
    return {
        "drift": errors.drift_percent,
        "turn": errors.drift_deg_per_100m,
        "speed": errors.rpe_v_rms,
        "ate": errors.ate_rmse_m,
    }


def _judge_motions(measurements: Path, track: Path, truth: Path) -> dict[str, Cell]:
    """Returns the cells of the covariances that a front end states."""
    nees = measure_nees(measurements, track, truth)
    return {"nees": float(nees.mean()), "nees_median": float(np.median(nees))}


def _relate(rows: list[dict[str, Cell]]) -> None:
    """Adds psi's drift over that of KISS-ICP to psi's row."""
    drifts = {cells["front_end"]: cells.get("drift") for cells in rows}
    ours, rival = drifts[OURS], drifts[RIVAL]
    known = isinstance(ours, float) and isinstance(rival, float)
    for cells in rows:
        cells["of_rival"] = ours / rival if known and cells["front_end"] == OURS else None


def _mean(values: list[Cell]) -> float | None:
    """Returns the mean of numbers, or None where one of them is not known."""
    known = [value for value in values if isinstance(value, float | int)]
    return float(np.mean(known)) if known and len(known) == len(values) else None


_TWIN_RUNS = [
    _Run(world, f"{name}, first {scans}", partial(twin, name, world, seed, scans))
    for world, scans in (("kind", 800), ("hard", 400))
    for name, seed in (("kaist01", 1), ("kaist02", 2))
]
_SHORT_SEEDS = tuple(range(11, 21))
_QUEUE_SEEDS = (1, 2, 3, 4, 5)


def _measure_heading(out: Path) -> list[Row]:
    rows = []
    for world in _WORLDS:
        drifts: dict[str, list[float]] = {"psi": [], "kiss_icp": []}
        for data in (simulate_short_city(world, seed) for seed in _SHORT_SEEDS):
            compared = compare(data, out / data.name, tuple(drifts), back_end=False)
            for name, values in drifts.items():
                values.append(score(compared / name / "odometry.tum", data / TRUTH).heading_deg_per_km)
        for name, values in drifts.items():
            mean, error = float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(len(values)))
            cells: dict[str, Cell] = {"world": world, "front_end": FRONT_ENDS[name], "mean": mean, "error": error}
            cells |= {"errors_off": abs(mean) / error, "rms": float(np.sqrt(np.mean(np.square(values))))}
            rows.append(Row(cells, judged=name == "psi"))
    return rows


def _measure_lockstep(out: Path) -> list[Row]:
    rows = []
    for seed in _QUEUE_SEEDS:
        data = simulate("queue", "hard", seed, 90.0)
        compared = compare(data, out / data.name, tuple(FRONT_ENDS), back_end=False)
        for name, shown in FRONT_ENDS.items():
            cells: dict[str, Cell] = {"run": f"seed {seed}", "front_end": shown}
            track = compared / name / "odometry.tum"
            if track.exists():
                errors = score(track, data / TRUTH)
                cells |= {"followed": errors.followed, "drift": errors.drift_percent, "speed": errors.rpe_v_rms}
            rows.append(Row(cells, judged=name == "psi"))
    return rows


BENCHMARKS = {
    "twin": Benchmark(
        study=True,
        what="The first scans of the city twin, by radar alone: every front end gets the same returns.",
        data="twin",
        seeds=(1, 2),
        columns=_COLUMNS,
        measure=partial(_measure, _TWIN_RUNS),
        bounds=(
            Bound("of_rival", {"front_end": OURS}, most=1.0),
            Bound("nees_alone", {"front_end": OURS}, most=2.5),
            Bound("nees_alone", {"front_end": OURS, "run": _MEAN}, least=0.2, most=1.6),
        ),
    ),
    "heading": Benchmark(
        study=True,
        what="Heading drift over ten drives of a minute each, before loops; counter-clockwise is positive.",
        data="simulated",
        seeds=_SHORT_SEEDS,
        columns=(
            label("world", "world"),
            label("front_end", "front end"),
            Column("mean", "mean [deg/km]", "{:+.3f}"),
            Column("error", "its standard error", "{:.3f}"),
            Column("errors_off", "mean over its error", "{:.1f}"),
            Column("rms", "RMS [deg/km]", "{:.3f}", Goal.LOW),
        ),
        measure=_measure_heading,
        bounds=(Bound("errors_off", {"front_end": OURS}, most=2.0),),
    ),
    "lockstep": Benchmark(
        study=True,
        what="A minute among vehicles that move in exact lockstep with the own one, before loops.",
        data="simulated",
        seeds=_QUEUE_SEEDS,
        columns=(
            label("run", "run"),
            label("front_end", "front end"),
            Column("followed", "steps less than 1 m/s off", "{:.1%}", Goal.HIGH),
            Column("drift", "drift [%]", "{:.3f}"),
            Column("speed", "speed RMS [m/s]", "{:.3f}"),
        ),
        measure=_measure_lockstep,
        bounds=(Bound("followed", {"front_end": OURS}, least=0.99),),
    ),
}
