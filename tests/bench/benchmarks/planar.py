"""Runs of planar lidars with relations that people verified by hand, beside published figures."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.commands import read_json, run_by_default
from bench.recordings import SHARED, shared
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from mqslam.backend.marginals import Uncertainty
from mqslam.commands.run import open_job
from mqslam.config import Config
from mqslam.core import se2
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.slam import Slam

_NAMES = ("intel", "fr079")
_OURS = "psi"
# Published by Kuemmerle et al. 2009 (scan matching, RBPF, Graph Mapping), and by Hess et al. 2016 (Cartographer): metres and
# degrees of all relations.
_PUBLISHED = {
    "intel": {"Graph Mapping": (0.031, 1.3), "Cartographer": (0.0229, 0.453), "RBPF": (0.070, None)},
    "fr079": {"Graph Mapping": (0.056, 0.6), "Cartographer": (0.0452, 0.538), "RBPF": (0.061, None)},
}
_MOST = {"intel": (0.030, 0.6), "fr079": (0.045, 0.55)}  # bounds on metres and degrees of all relations
_MOST_BY_LOOPS_M = 0.05
_NEES = 0.3, 3.0  # bounds on the mean over all relations of the normalised squared error over 3
_NEAR_S = 0.02  # a relation counts if there are poses within this time of both of its ends, as the judge has it
_LOOP_S = 60.0  # relations of loops have more than this time between their ends, as the judge has it
_OUTLIER_M = 0.03  # relations with larger errors count less in the search for the point that fits best


def _measure(out: Path) -> list[Row]:
    rows = []
    for name in _NAMES:
        log = shared(SHARED / "data" / "planar" / f"{name}.log.gz")
        folder = run_by_default(log, out / name)
        summary = read_json(folder / "summary.json")
        dataset = summary["dataset"]
        cells: dict[str, Cell] = {
            "run": name,
            "method": _OURS,
            **_score(folder / "trajectory.tum", name),
            "verdict": summary["verdict"]["status"],
            "real_time": dataset["duration_s"] / summary["runtime_s"]["total"],
            **_judge_relations(log, name),
        }
        rows.append(Row(cells))
        rows.append(Row({"run": name, "method": "wheels", **_score(folder / "odometry.tum", name)}, judged=False))
        for method, (metres, degrees) in _PUBLISHED[name].items():
            rows.append(Row({"run": name, "method": method, "metres": metres, "degrees": degrees}, judged=False))
    return rows


def _score(trajectory: Path, name: str) -> dict[str, Cell]:
    """Scores a trajectory, a TUM file, as the judge of shared material scores it."""
    judge = shared(SHARED / "tools" / "score_relations.py")
    words = [sys.executable, str(judge), str(trajectory), str(_find_relations(name))]
    found = json.loads(subprocess.run([*words, "--json"], capture_output=True, check=True, text=True).stdout)
    (metres, metres_sd), (degrees, _), (by_loops, _) = (found[key] for key in ("metres", "degrees", "loops_metres"))
    return {
        "scored": f"{found['scored']} of {found['of']}",
        "metres": metres,
        "metres_sd": metres_sd,
        "degrees": degrees,
        "by_loops": by_loops,
    }


def _find_relations(name: str) -> Path:
    """Returns the file of a run's relations: two times [s], x, y, z [m], roll, pitch and yaw [rad] in each line."""
    return shared(SHARED / "data" / "planar" / f"{name}.relations.gz")


def _judge_relations(log: Path, name: str) -> dict[str, Cell]:
    """Compares the errors of relations with the run's covariances, and finds the point for which the relations hold best.

    Relations between poses of a point ahead of the lidar differ from those of the lidar wherever the robot has turned.
    A run does not write covariances of poses relative to any other pose, so that the log is solved once more.
    """
    job = open_job(log, Config())
    with LocalEngine(2) as engine:
        run = Slam(job.settings, job.frontend, Runner(engine)).run(job.recording, job.odometry, job.sensors)
    relations = np.loadtxt(_find_relations(name), ndmin=2)
    times = cKDTree(run.optimised.stamps_us[:, None] * 1e-6)
    (late_a, a), (late_b, b) = (times.query(relations[:, [k]]) for k in (0, 1))
    near = (late_a <= _NEAR_S) & (late_b <= _NEAR_S) & (a != b)
    a, b, relations, poses = a[near], b[near], relations[near], run.optimised.poses
    moved = se2.between(poses[a], poses[b])
    errors = moved - relations[:, [2, 3, 7]]
    errors[:, 2] = se2.wrap(errors[:, 2])
    covariances = Uncertainty(run.graph, run.values).relate(list(zip(a.tolist(), b.tolist(), strict=True)))
    turned = np.column_stack([np.cos(moved[:, 2]) - 1.0, np.sin(moved[:, 2])])  # how much farther a point 1 m ahead moves
    ahead = float(
        least_squares(lambda m: (errors[:, :2] + m * turned).ravel(), 0.0, loss="soft_l1", f_scale=_OUTLIER_M).x[0]
    )
    there = np.column_stack([errors[:, :2] + ahead * turned, errors[:, 2]])
    are_loops = np.abs(relations[:, 1] - relations[:, 0]) > _LOOP_S
    return {
        "nees": float(se2.normalise(errors, covariances).mean() / 3.0),
        "nees_median": float(np.median(se2.normalise(errors, covariances)) / 3.0),
        "ahead": ahead,
        "metres_there": float(np.hypot(*there[:, :2].T).mean()),
        "by_loops_there": float(np.hypot(*there[are_loops, :2].T).mean()),
        "nees_there": float(np.median(se2.normalise(there, covariances)) / 3.0),
    }


BENCHMARKS = {
    "planar": Benchmark(
        study=True,
        what="Two public runs of planar lidars by default settings: the mean error of relations that people verified, all "
        "of them and those with over a minute between their ends, beside published figures, which are not measured here.",
        data="real",
        columns=(
            label("run", "run"),
            label("method", "method"),
            Column("scored", "relations", "{}"),
            Column("metres", "[m]", "{:.4f}", Goal.LOW),
            Column("metres_sd", "sd [m]", "{:.3f}"),
            Column("degrees", "[deg]", "{:.3f}", Goal.LOW),
            Column("by_loops", "of loops [m]", "{:.4f}", Goal.LOW),
            Column("nees", "NEES/3", "{:.2f}", Goal.ONE),
            Column("nees_median", "median", "{:.2f}"),
            Column("ahead", "best point ahead [m]", "{:+.3f}"),
            Column("metres_there", "error there [m]", "{:.4f}"),
            Column("by_loops_there", "of loops there [m]", "{:.4f}"),
            Column("nees_there", "median NEES/3 there", "{:.2f}"),
            Column("verdict", "verdict", "{}"),
            Column("real_time", "times real time", "{:.1f}"),
        ),
        measure=_measure,
        bounds=(
            *(Bound("metres", {"run": name, "method": _OURS}, most=_MOST[name][0]) for name in _NAMES),
            *(Bound("degrees", {"run": name, "method": _OURS}, most=_MOST[name][1]) for name in _NAMES),
            Bound("by_loops", {"method": _OURS}, most=_MOST_BY_LOOPS_M),
            Bound("nees", {"method": _OURS}, least=_NEES[0], most=_NEES[1]),
        ),
    ),
}
