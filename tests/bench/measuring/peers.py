"""All front ends on the same returns of a recording, and KISS-SLAM where it is installed: a row each."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from bench.benchmark import Cell, Column, Goal, Row, label
from bench.measuring.calibration import measure_nees, measure_pose_nees
from bench.measuring.commands import FRONT_ENDS, OURS, RIVAL, compare, read_json, run_without_loops
from bench.measuring.kiss_slam import find_interpreter, run_kiss_slam
from bench.measuring.recordings import TRUTH
from bench.measuring.scorer import score

MEAN = "mean"
KISS_SLAM = "KISS-SLAM, random heights"
COLUMNS = (
    label("world", "world"),
    label("run", "run"),
    label("front_end", "front end"),
    Column("drift", "drift [%]", "{:.3f}", Goal.LOW),
    Column("turn", "[deg/100 m]", "{:.3f}", Goal.LOW),
    Column("speed", "speed RMS [m/s]", "{:.3f}", Goal.LOW),
    Column("ate", "ATE [m]", "{:.2f}", Goal.LOW),
    Column("ate_after", "ATE after loops [m]", "{:.3f}", Goal.LOW),
    Column("loops", "loops", "{:.0f}"),
    Column("nees", "NEES/3", "{:.2f}", Goal.ONE),
    Column("nees_median", "its median", "{:.2f}"),
    Column("nees_poses", "poses' NEES/3, with loops", "{:.2f}"),
    Column("nees_alone", "without loops", "{:.2f}"),
    Column("of_rival", "of KISS-ICP's drift", "{:.2f}", Goal.LOW),
)


class Run(NamedTuple):
    """A recording to compare on.

    Args:
        world, name: as the table shows them.
        data: the recording.
    """

    world: str
    name: str
    data: Path


def measure_peers(run: Run, out: Path, *, back_end: bool = True) -> list[Row]:
    """Returns a row per front end; none of them is judged, since chance decides much of a single run.

    Args:
        run: the recording.
        out: folder for results.
        back_end: whether graph and loops follow.
    """
    folder = compare(run.data, out / run.data.name, tuple(FRONT_ENDS), back_end=back_end)
    loops = {row["name"]: row.get("loops") for row in read_json(folder / "compare.json")["rows"]}
    rows = []
    for name, shown in FRONT_ENDS.items():
        cells: dict[str, Cell] = {"world": run.world, "run": run.name, "front_end": shown}
        own = folder / name
        if own.is_dir():
            cells |= _score(own / "odometry.tum", own / "trajectory.tum" if back_end else None, run.data / TRUTH)
            nees = measure_nees(own / "measurements.csv", own / "trajectory.tum", run.data / TRUTH)
            cells |= {
                "loops": loops[name] if back_end else None,
                "nees": float(nees.mean()),
                "nees_median": float(np.median(nees)),
                "nees_poses": measure_pose_nees(own, run.data / TRUTH) if back_end else None,
            }
        if shown == OURS:
            alone = run_without_loops(run.data, out / f"{run.data.name}-without-loops")
            cells["nees_alone"] = measure_pose_nees(alone, run.data / TRUTH)
        rows.append(cells)
    python = find_interpreter()
    if python is not None and back_end:
        slam = run_kiss_slam(python, run.data, folder / "kiss_icp" / "measurements.csv", out / f"{run.data.name}-kiss-slam")
        cells = {"world": run.world, "run": run.name, "front_end": KISS_SLAM, "loops": slam.loops}
        rows.append(cells | _score(slam.odometry, slam.trajectory, run.data / TRUTH))
    _relate(rows)
    return [Row(cells, judged=False) for cells in rows]


def average(rows: list[Row], worlds: tuple[str, ...]) -> list[Row]:
    """Returns the means over the runs of each world, a row per front end, of which psi's is judged."""
    means = []
    for world in worlds:
        names = dict.fromkeys(row.cells["front_end"] for row in rows if row.cells["world"] == world)
        of_world: list[dict[str, Cell]] = []
        for name in names:
            alike = [row.cells for row in rows if (row.cells["world"], row.cells["front_end"]) == (world, name)]
            numbers = {
                column.key: _mean([cells.get(column.key) for cells in alike]) for column in COLUMNS if not column.label
            }
            of_world.append({"world": world, "run": MEAN, "front_end": name, **numbers})
        _relate(of_world)
        means += [Row(cells, judged=cells["front_end"] == OURS) for cells in of_world]
    return means


def _score(odometry: Path, trajectory: Path | None, truth: Path) -> dict[str, Cell]:
    """Returns the cells of a track before loops, and after them where there are any."""
    errors = score(odometry, truth)
    return {
        "drift": errors.drift_percent,
        "turn": errors.drift_deg_per_100m,
        "speed": errors.rpe_v_rms,
        "ate": errors.ate_rmse_m,
        "ate_after": None if trajectory is None else score(trajectory, truth).ate_rmse_m,
    }


def _relate(rows: list[dict[str, Cell]]) -> None:
    """Adds psi's drift over that of KISS-ICP to psi's row."""
    by_name = {cells["front_end"]: cells for cells in rows}
    ours, rival = by_name[OURS].get("drift"), by_name[RIVAL].get("drift")
    by_name[OURS]["of_rival"] = ours / rival if isinstance(ours, float) and isinstance(rival, float) else None
    for name in by_name.keys() - {OURS}:
        by_name[name]["of_rival"] = None


def _mean(values: list[Cell]) -> float | None:
    """Returns the mean of numbers, or None where one of them is not known."""
    known = [value for value in values if isinstance(value, float | int)]
    return float(np.mean(known)) if known and len(known) == len(values) else None
