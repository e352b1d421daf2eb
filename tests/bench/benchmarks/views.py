"""How far what the radar sees moves along with it, which shortens the motions that psi measures."""

from __future__ import annotations

from collections.abc import Sequence
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
from mqslam.detection.stage import detect_all
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.formats.recordings import open_recording
from mqslam.mapping.render import place_along
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
            beam = beam_of(config.estimator, 0.0)
            points = [place_along(scan.returns, scans.start_times, true, beam).points for scan in scans]
            motions = measure("psi", scans, Context.of(recording, config), beam, runner)
            cells: dict[str, Cell] = {"kind": drive.kind, "seed": drive.data.name.split("seed")[1].split("-")[0]}
            for way in _WAYS_M:
                cells[f"pull{way:.0f}"] = _measure_pull(points, true, way)
            tracked = Problem(motions, []).solve_poses([])
            rows.append(Row(cells | {"scale": _compare_lengths(tracked, true, _WAYS_M[1])}))
    return rows


def _measure_pull(points: Sequence[NDArray[np.float64]], true: se2.Array, way: float) -> float:
    """Returns how far returns lie ahead of the returns of the same objects a path of `way` before, as a share of the path.

    Two returns are of one object if each is the nearest to the other.

    Args:
        points: for each scan the points (N, 2) of its returns, placed by the true poses.
        true: (K, 3) true poses at the starts of the scans.
        way: path between the two views [m].
    """
    travelled, pulls = se2.path_lengths(true), []
    for first in range(0, len(points), _EVERY):
        second = int(np.searchsorted(travelled, travelled[first] + way))
        if second >= len(points):
            break
        moved = true[second, :2] - true[first, :2]
        before, after = points[first], points[second]
        distances, nearest = cKDTree(after).query(before, distance_upper_bound=_SAME_M)
        found = np.flatnonzero(np.isfinite(distances))
        _, back = cKDTree(before).query(after)
        mutual = found[back[nearest[found]] == found]
        pulls.append((after[nearest[mutual]] - before[mutual]) @ moved / (moved @ moved))
    return float(np.mean(np.concatenate(pulls)))


def _compare_lengths(tracked: se2.Array, true: se2.Array, way: float) -> float:
    """Returns the mean ratio of tracked to true distances between poses with a path of `way` between them, minus 1."""
    travelled = se2.path_lengths(true)
    ends = np.flatnonzero(travelled >= way)
    begins = np.searchsorted(travelled, travelled[ends] - way, side="right") - 1
    lengths = (np.linalg.norm(poses[ends, :2] - poses[begins, :2], axis=1) for poses in (tracked, true))
    return float(np.mean(np.divide(*lengths)) - 1.0)


BENCHMARKS = {
    "views": Benchmark(
        study=True,
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
