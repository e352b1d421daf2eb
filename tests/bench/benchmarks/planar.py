"""Runs of planar lidars with relations that people verified by hand, beside published figures."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from bench.benchmark import Benchmark, Bound, Cell, Column, Goal, Row, label
from bench.commands import read_json, run_by_default
from bench.recordings import SHARED, shared
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from mqslam.backend.marginals import Uncertainty
from mqslam.commands.run import open_job
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.slam import Slam
from mqslam.solution import Run

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
_SAME_S = 1e-4  # a relation whose ends are stamps of scans, to within rounding, belongs to these scans
_LOOP_S = 60.0  # relations of loops have more than this time between their ends, as the judge has it
_OUTLIER_M = 0.03  # relations with larger errors count less in the search for the point that fits best


def _measure(out: Path) -> list[Row]:
    rows = []
    for name in _NAMES:
        folder = run_by_default(shared(SHARED / "data" / "planar" / f"{name}.log.gz"), out / name)
        summary = read_json(folder / "summary.json")
        dataset = summary["dataset"]
        cells: dict[str, Cell] = {
            "run": name,
            "method": _OURS,
            **_score(folder / "trajectory.tum", name),
            "verdict": summary["verdict"]["status"],
            "real_time": dataset["duration_s"] / summary["runtime_s"]["total"],
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


class _Compared(NamedTuple):
    """The K relations of a run that count, beside the poses of a trajectory."""

    pairs: list[tuple[int, int]]  # the indices of the poses at both ends
    errors: NDArray[np.float64]  # (K, 3) motion between these poses minus the relation [m, m, rad]
    turned: NDArray[np.float64]  # (K, 2) how much farther a point 1 m ahead of the lidar moves than the lidar [1]
    are_loops: NDArray[np.bool_]  # (K,)
    are_of_scans: NDArray[np.bool_]  # (K,) whether both ends are stamps of scans

    @classmethod
    def of(cls, track: Trajectory, name: str) -> _Compared:
        """Compares a trajectory with the relations of a run; a relation counts as for the judge of shared material."""
        relations = np.loadtxt(_find_relations(name), ndmin=2)
        times = cKDTree(track.stamps_us[:, None] * 1e-6)
        (apart_a, a), (apart_b, b) = (times.query(relations[:, [k]]) for k in (0, 1))
        near = (apart_a <= _NEAR_S) & (apart_b <= _NEAR_S) & (a != b)
        apart, a, b, relations = np.maximum(apart_a, apart_b)[near], a[near], b[near], relations[near]
        moved = se2.between(track.poses[a], track.poses[b])
        errors = moved - relations[:, [2, 3, 7]]
        errors[:, 2] = se2.wrap(errors[:, 2])
        turned = np.column_stack([np.cos(moved[:, 2]) - 1.0, np.sin(moved[:, 2])])
        pairs = list(zip(a.tolist(), b.tolist(), strict=True))
        return cls(pairs, errors, turned, np.abs(relations[:, 1] - relations[:, 0]) > _LOOP_S, apart <= _SAME_S)

    def carry(self, ahead: float) -> NDArray[np.float64]:
        """Returns the errors (K, 3) of the relations if they are those of a point ahead of the lidar [m, m, rad]."""
        return np.column_stack([self.errors[:, :2] + ahead * self.turned, self.errors[:, 2]])


def _measure_relations(_out: Path) -> list[Row]:
    rows = []
    for name in _NAMES:
        job = open_job(shared(SHARED / "data" / "planar" / f"{name}.log.gz"), Config())
        with LocalEngine(2) as engine:
            run = Slam(job.settings, job.frontend, Runner(engine)).run(job.recording, job.odometry, job.sensors)
        used = _Compared.of(run.optimised, name)
        ahead = _find_point(used)
        whole = _Compared.of(job.recording.complete(run.optimised), name)
        lengths = np.hypot(*whole.carry(ahead)[:, :2].T)
        of_scans = whole.errors[whole.are_of_scans]
        cells: dict[str, Cell] = {
            "run": name,
            "of_scans": f"{len(of_scans)} of {len(whole.errors)}",
            "metres_of_scans": float(np.hypot(*of_scans[:, :2].T).mean()),
            "degrees_of_scans": float(np.degrees(np.abs(of_scans[:, 2])).mean()),
            "ahead": ahead,
            "metres_there": float(lengths.mean()),
            "by_loops_there": float(lengths[whole.are_loops].mean()),
        }
        rows.append(Row(cells | _judge_covariances(run, used, ahead)))
    return rows


def _find_point(compared: _Compared) -> float:
    """Finds how far ahead of the lidar the point is for which relations hold best [m]."""
    found = least_squares(lambda ahead: compared.carry(ahead[0])[:, :2].ravel(), [0.0], loss="soft_l1", f_scale=_OUTLIER_M)
    return float(found.x[0])


def _judge_covariances(run: Run, compared: _Compared, ahead: float) -> dict[str, float]:
    """Compares the errors of relations with the run's covariances, also if the relations are those of a point ahead."""
    covariances = Uncertainty(run.graph, run.values).relate(compared.pairs)
    nees, nees_there = (se2.normalise(compared.carry(m), covariances) / 3.0 for m in (0.0, ahead))
    return {
        "nees": float(nees.mean()),
        "nees_median": float(np.median(nees)),
        "nees_of_scans": float(nees[compared.are_of_scans].mean()),
        "nees_there": float(np.median(nees_there)),
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
            Column("verdict", "verdict", "{}"),
            Column("real_time", "times real time", "{:.1f}"),
        ),
        measure=_measure,
        bounds=(
            *(Bound("metres", {"run": name, "method": _OURS}, most=_MOST[name][0]) for name in _NAMES),
            *(Bound("degrees", {"run": name, "method": _OURS}, most=_MOST[name][1]) for name in _NAMES),
            Bound("by_loops", {"method": _OURS}, most=_MOST_BY_LOOPS_M),
        ),
    ),
    "relations": Benchmark(
        study=True,
        what="Errors of verified relations, beside the covariances that the runs of two planar lidars state for the same "
        "relative poses (where both scans are used), also of the relations alone whose ends are stamps of scans, and the "
        "point ahead of the lidar for which the relations hold best.",
        data="real",
        columns=(
            label("run", "run"),
            Column("nees", "NEES/3", "{:.2f}", Goal.ONE),
            Column("nees_median", "its median", "{:.2f}"),
            Column("of_scans", "with stamps of scans", "{}"),
            Column("metres_of_scans", "their [m]", "{:.4f}"),
            Column("degrees_of_scans", "their [deg]", "{:.3f}"),
            Column("nees_of_scans", "their NEES/3", "{:.2f}"),
            Column("ahead", "best point ahead [m]", "{:+.3f}"),
            Column("metres_there", "error there [m]", "{:.4f}"),
            Column("by_loops_there", "of loops there [m]", "{:.4f}"),
            Column("nees_there", "median NEES/3 there", "{:.2f}"),
        ),
        measure=_measure_relations,
        bounds=(Bound("nees", {}, least=_NEES[0], most=_NEES[1]),),
    ),
}
