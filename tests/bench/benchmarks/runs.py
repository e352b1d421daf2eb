"""Whole runs of mqslam: errors, loops and covariances against the truth, time by stage, memory by length."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import numpy as np
from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.commands import read_json, register, run
from bench.recordings import TRUTH, simulate_city, twin
from bench.scorer import headings, measure_pose_nees, place, read_trajectory, relative, score, wrap
from bench.timing import Took
from evo.core.trajectory import PoseTrajectory3D
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.config import Config
from mqslam.detection.stage import detect_all
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.formats.recordings import open_recording

_NEAR_M, _PATH_M, _SPACING_M = 10.0, 60.0, 2.6  # a revisit; its way round; how far a loop reaches along the path
_ACROSS = 0.5  # sine of the angle from which two passes cross


def _measure_whole(runs: Iterable[tuple[str, Callable[[], Path]]], out: Path) -> list[Row]:
    """Returns a row for each recording, given its name and a function that finds it."""
    return [_measure_run(name, find(), out) for name, find in runs]


def _measure_run(name: str, data: Path, out: Path) -> Row:
    folder, truth = run(data, out / data.name), data / TRUTH
    summary = read_json(folder / "summary.json")
    before, after = (score(folder / f"{track}.tum", truth) for track in ("odometry", "trajectory"))
    cells: dict[str, Cell] = {
        "run": name,
        "drift": before.drift_percent,
        "turn": before.drift_deg_per_100m,
        "ate": before.ate_rmse_m,
        "ate_after": after.ate_rmse_m,
        **_judge_loops(folder / "graph.g2o", folder / "trajectory.tum", truth),
        "torn": summary["inflation"]["torn"] / summary["inflation"]["windows"],
        "nees_poses": measure_pose_nees(folder, truth),
        "real_time": summary["dataset"]["duration_s"] / summary["runtime_s"]["total"],
        "peak_mb": summary["peak_rss_mb"],
    }
    return Row(cells)


def _judge_loops(graph: Path, trajectory: Path, truth: Path) -> dict[str, Cell]:
    """Returns the number of loops, the largest errors of one [m], [deg], and the share of revisiting scans that are tied.

    Args:
        graph: g2o file, whose first vertices are the scans in their order; those of the submaps come after them.
        trajectory: TUM file with the stamps of the scans.
        truth: TUM file.
    """
    stamps = read_trajectory(trajectory).timestamps
    true = place(read_trajectory(truth), stamps)
    words = [line.split() for line in graph.read_text(encoding="utf-8").splitlines() if line.startswith("EDGE_SE2")]
    edges = [(int(w[1]), int(w[2]), np.array(w[3:6], dtype=float)) for w in words]
    loops = [(a, b, motion) for a, b, motion in edges if max(a, b) < len(stamps) and b != a + 1]
    tied = _find_tied(true, np.array([last for _, last, _ in loops], dtype=int))
    errors = np.array([_between(relative(true, first, last), motion) for first, last, motion in loops]).reshape(-1, 3)
    return {
        "loops": len(loops),
        "worst_m": float(np.hypot(*errors[:, :2].T).max()) if loops else None,
        "worst_deg": float(np.rad2deg(np.abs(errors[:, 2]).max())) if loops else None,
        "tied": float(tied.mean()) if len(tied) else None,
    }


def _find_tied(true: PoseTrajectory3D, ends: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Returns for every scan that revisits a place whether a loop ends near it.

    A scan revisits if it comes near one that lies some way before it, with the same or the opposite heading.
    """
    places, yaw = true.positions_xyz[:, :2], headings(true)
    travelled = np.r_[0.0, np.cumsum(np.hypot(*np.diff(places, axis=0).T))]
    tied = []
    for k, near in enumerate(cKDTree(places).query_ball_point(places, _NEAR_M)):
        earlier = np.array(near)[travelled[k] - travelled[near] > _PATH_M]
        if np.any(np.abs(np.sin(yaw[earlier] - yaw[k])) < _ACROSS):
            tied.append(np.any(np.abs(travelled[ends] - travelled[k]) <= _SPACING_M))
    return np.array(tied, dtype=bool)


def _between(true: NDArray[np.float64], motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the error (3,) of a motion (3,), in the frame that the true one ends in."""
    dx, dy = motion[:2] - true[:2]
    c, s = np.cos(true[2]), np.sin(true[2])
    return np.array([c * dx + s * dy, c * dy - s * dx, wrap(motion[2] - true[2])])


_TWO, _ONE, _RIVAL = "mqslam, two jobs", "mqslam, one job", "KISS-ICP's odometry"
_TIMED = ("windows", "loops", "render", "check")


def _measure_against_rival(out: Path) -> list[Row]:
    data = twin("kaist01", "hard", 1)
    rows = [_time_run(data, out / name, name, jobs) for name, jobs in ((_TWO, 2), (_ONE, 1))]
    rows.append(_time_rival(data))
    walls = [float(row["wall_s"] or 0.0) for row in rows]
    return [
        Row({**row, "over_two": wall / walls[0]}, judged=row["run"] == _TWO) for row, wall in zip(rows, walls, strict=True)
    ]


def _time_run(data: Path, out: Path, name: str, jobs: int) -> dict[str, Cell]:
    """Returns the cells of a run of the command."""
    begin = Took.now()
    summary = read_json(run(data, out, "--jobs", str(jobs)) / "summary.json")
    took = Took.now().since(begin)
    stages = {stage: summary["runtime_s"][stage] for stage in _TIMED}
    real_time = summary["dataset"]["duration_s"] / took.wall_s
    return {"run": name, **took._asdict(), "real_time": real_time, **stages, "peak_mb": summary["peak_rss_mb"]}


def _time_rival(data: Path) -> dict[str, Cell]:
    """Returns the cells of reading and detecting by two jobs, and KISS-ICP scan by scan after that."""
    begin = Took.now()
    recording = open_recording(data)
    with LocalEngine(2) as engine:
        scans, _ = detect_all(recording, Config().detector, Runner(engine))
    detected = Took.now()
    register(scans)
    took, tracking = Took.now().since(begin), Took.now().since(detected)
    real_time = len(recording) * recording.revolution_s / took.wall_s
    unknown = dict.fromkeys((*_TIMED[1:], "peak_mb"))
    return {"run": _RIVAL, **took._asdict(), "real_time": real_time, "windows": tracking.wall_s, **unknown}


_STAGES = ("read", "detect", "windows", "loops", "optimise", "render", "check", "total")


def _measure_stages(out: Path) -> list[Row]:
    data = simulate_city("hard", 1)
    summary = read_json(run(data, out / data.name, "--jobs", "1") / "summary.json")
    hours, spent = summary["dataset"]["duration_s"] / 3600.0, summary["runtime_s"]
    return [
        Row({"stage": stage, "seconds": spent[stage] / hours, "share": spent[stage] / spent["total"]}, judged=False)
        for stage in _STAGES
    ]


def _measure_memory(out: Path) -> list[Row]:
    rows = []
    for hours in (1, 4, 12):
        environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
        command = [sys.executable, "-m", "bench.endless", str(hours), out / f"{hours}h"]
        shown = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
        rows.append(Row({"hours": f"{hours}", **json.loads(shown.stdout)}))
    return rows


_COLUMNS = (
    label("run", "run"),
    Column("drift", "drift [%]", "{:.3f}", Goal.LOW),
    Column("turn", "[deg/100 m]", "{:.3f}", Goal.LOW),
    Column("ate", "ATE [m]", "{:.2f}"),
    Column("ate_after", "ATE after loops [m]", "{:.3f}", Goal.LOW),
    Column("loops", "loops", "{:.0f}"),
    Column("worst_m", "worst loop [m]", "{:.2f}"),
    Column("worst_deg", "[deg]", "{:.2f}"),
    Column("tied", "revisits tied", "{:.0%}", Goal.HIGH),
    Column("torn", "windows torn", "{:.1%}"),
    Column("nees_poses", "poses' NEES/3", "{:.2f}"),
    Column("real_time", "times real time", "{:.1f}"),
    Column("peak_mb", "peak [MB]", "{:.0f}"),
)
_BOUNDS = (Bound("worst_m", {}, most=1.0), Bound("worst_deg", {}, most=1.0), Bound("tied", {}, least=0.6))

BENCHMARKS = {
    "full": Benchmark(
        what="Whole runs of two kilometres with default settings, by radar alone.",
        data="simulated",
        seeds=(1,),
        columns=_COLUMNS,
        measure=partial(
            _measure_whole, [(f"{world}, seed 1", partial(simulate_city, world, 1)) for world in ("kind", "hard")]
        ),
        bounds=(*_BOUNDS, Bound("peak_mb", {}, most=2000.0)),
    ),
    "twin_full": Benchmark(
        study=True,
        what="Whole runs of the city twin, about 6 km each, by radar alone.",
        data="twin",
        seeds=(1, 2),
        columns=_COLUMNS,
        measure=partial(
            _measure_whole,
            [
                (f"{name}, {world}", partial(twin, name, world, seed))
                for world in ("kind", "hard")
                for name, seed in (("kaist01", 1), ("kaist02", 2))
            ],
        ),
        bounds=_BOUNDS,
    ),
    "whole_run": Benchmark(
        study=True,
        what="A drive of KAIST01 in full on an idle machine, in seconds of wall time unless the column says otherwise.",
        data="twin",
        seeds=(1,),
        columns=(
            label("run", "run"),
            Column("wall_s", "all [s]", "{:.0f}"),
            Column("processor_s", "processor time [s]", "{:.0f}"),
            Column("real_time", "times real time", "{:.1f}"),
            Column("over_two", "times that of two jobs", "{:.2f}"),
            Column("windows", "tracking", "{:.0f}"),
            Column("loops", "loops", "{:.0f}"),
            Column("render", "render", "{:.0f}"),
            Column("check", "check", "{:.0f}"),
            Column("peak_mb", "largest process [MB]", "{:.0f}"),
        ),
        measure=_measure_against_rival,
        bounds=(
            Bound("real_time", {"run": _TWO}, least=10.0),
            Bound("over_two", {"run": _ONE}, least=1.7),
            Bound("over_two", {"run": _RIVAL}, least=0.25),
        ),
    ),
    "stages": Benchmark(
        study=True,
        what="Seconds on one core per hour of radar (14,400 scans) of the hard city.",
        data="simulated",
        seeds=(1,),
        columns=(
            label("stage", "stage"),
            Column("seconds", "[s] per hour of radar", "{:.0f}"),
            Column("share", "share", "{:.1%}"),
        ),
        measure=_measure_stages,
    ),
    "memory": Benchmark(
        study=True,
        what="A whole run with two jobs, loops and check included, everything written: a drive past few points.",
        data="simulated",
        columns=(
            label("hours", "hours"),
            Column("scans", "scans", "{:.0f}"),
            Column("loops", "loops", "{:.0f}"),
            Column("seconds", "[s]", "{:.0f}"),
            Column("peak_mb", "largest memory of the process [MB]", "{:.0f}", Goal.LOW),
        ),
        measure=_measure_memory,
        bounds=(Bound("peak_mb", {"hours": "1"}, most=3000.0), Bound("peak_mb", {"hours": "12"}, most=3000.0)),
    ),
}
