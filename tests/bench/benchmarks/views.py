"""How far what the radar sees moves along with it, which shortens the motions that psi measures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from bench.benchmark import Benchmark, Cell, Column, Row, label
from bench.benchmarks.uncertainty import list_drives, read_truth
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.backend.measuring import measure
from mqslam.backend.problem import Problem
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.scans import Scans
from mqslam.detection.stage import detect_all
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.formats.recordings import open_recording
from mqslam.psi.place import beam_of

_WAYS_M = (20.0, 40.0, 80.0)  # paths between two views
_EVERY = 3  # one scan in so many is compared with a later one
_SAME_M = 1.0  # two returns of one object are not farther apart


def _measure(out: Path) -> list[Row]:
    rows = []
    with LocalEngine(2) as engine:
        for drive in list_drives():
            recording, config, runner = open_recording(drive.data), Config(), Runner(engine)
            scans, _ = detect_all(recording, config.detector, runner)
            true = read_truth(drive.data, scans.stamps_us)
            context = Context.of(recording, config)
            motions = measure("psi", scans, context, beam_of(config.estimator, 0.0), runner)
            cells: dict[str, Cell] = {"kind": drive.kind, "seed": drive.data.name.split("seed")[1].split("-")[0]}
            for way in _WAYS_M:
                cells[f"pull{way:.0f}"] = _measure_pull(scans, true, way)
            tracked = Problem(motions, []).solve_poses([])
            rows.append(Row(cells | {"scale": _compare_lengths(tracked, true, _WAYS_M[1])}))
    return rows


def _measure_pull(scans: Scans, true: se2.Array, way: float) -> float:
    """Returns how far returns lie ahead of the returns of the same objects a path of `way` before, as a share of the path.

    All returns are placed by the true poses (K, 3). Two returns are of one object if each is the nearest to the other.
    """
    travelled, pulls = se2.path_lengths(true), []
    for first in range(0, len(scans), _EVERY):
        second = int(np.searchsorted(travelled, travelled[first] + way))
        if second >= len(scans):
            break
        moved = true[second, :2] - true[first, :2]
        before, after = (_place(scans, true, k) for k in (first, second))
        distances, nearest = cKDTree(after).query(before, distance_upper_bound=_SAME_M)
        found = np.flatnonzero(np.isfinite(distances))
        _, back = cKDTree(before).query(after)
        mutual = found[back[nearest[found]] == found]
        pulls.append((after[nearest[mutual]] - before[mutual]) @ moved / (moved @ moved))
    return float(np.mean(np.concatenate(pulls)))


def _place(scans: Scans, poses: se2.Array, k: int) -> NDArray[np.float64]:
    """Returns the points (N, 2) of the returns of scan k under the poses (K, 3) of all scans."""
    returns = scans[k].returns
    at = se2.smooth(scans.start_times, poses, returns.times)
    heading = at[:, 2] + returns.azimuths
    return at[:, :2] + returns.ranges[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])


def _compare_lengths(tracked: se2.Array, true: se2.Array, way: float) -> float:
    """Returns the mean ratio of tracked to true distances between poses with a path of `way` between them, minus 1."""
    travelled = se2.path_lengths(true)
    ends = np.flatnonzero(travelled >= way)
    begins = np.searchsorted(travelled, travelled[ends] - way, side="right") - 1
    lengths = (np.linalg.norm(poses[ends, :2] - poses[begins, :2], axis=1) for poses in (tracked, true))
    return float(np.mean(np.divide(*lengths)) - 1.0)


BENCHMARKS = {
    "views": Benchmark(
        what="How far returns, placed by the true poses, lie ahead of the returns of the same objects that were seen 20, 40 "
        "and 80 m of path before, as a share of this path; and by how much the motions that psi measures are too long.",
        data="simulated",
        seeds=(61, 62, 63, 64, 65),
        columns=(
            label("kind", "drives"),
            label("seed", "seed"),
            *(Column(f"pull{way:.0f}", f"moves along, {way:.0f} m", "{:+.3%}") for way in _WAYS_M),
            Column("scale", "ψ's motions too long by", "{:+.3%}"),
        ),
        measure=_measure,
    ),
}
