"""What a run leaves in its folder."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mqslam.config import dump_yaml, set_doppler_beta
from mqslam.core.measurement import Measurement
from mqslam.errors import tolerate
from mqslam.execution.files import write_json, write_text
from mqslam.formats.g2o import format_g2o
from mqslam.formats.nav2_map import write_nav2_map
from mqslam.formats.ply import write_ply
from mqslam.formats.tum import write_tum
from mqslam.mapping.occupancy_grid import occupancy_grid
from mqslam.solution import Run

_COLUMNS = [
    "t0",
    "t1",
    "dx",
    "dy",
    "dyaw",
    "cov_xx",
    "cov_xy",
    "cov_xyaw",
    "cov_yy",
    "cov_yyaw",
    "cov_yawyaw",
    "psi",
    "psi_odometry",
    "points",
    "matched",
    "status",
]


def write_run(folder: Path, run: Run, summary: dict[str, Any], notes: Sequence[str]) -> None:
    """Write every result file of a run but its report into an existing folder, those first that are worth the most.

    Map and graph may fail, by a fault of theirs or of a library or for want of memory: that is a warning then, and all
    others are written. The warning is added to those of the summary.

    Args:
        folder: where to.
        run: what there is to write.
        summary: content of summary.json, with its warnings.
        notes: what a user should know about how the recording was understood, for run.log.

    Raises:
        OutputError: a file cannot be written.
    """
    write_tum(folder / "trajectory.tum", run.optimised)
    write_tum(folder / "odometry.tum", run.odometry)
    write_text(folder / "measurements.csv", measurements_csv(run.measurements))
    write_text(folder / "config.yaml", dump_yaml(set_doppler_beta(run.config, run.doppler_beta)))
    _write_numbers(folder, summary, notes)
    failures: list[str] = []
    with tolerate("graph.g2o", failures):
        write_text(folder / "graph.g2o", format_g2o(run.graph.factors, run.values, run.graph.size))
    with tolerate("map.ply", failures):
        write_ply(folder / "map.ply", run.map_optimised)
    with tolerate("map.pgm", failures):
        write_nav2_map(folder, occupancy_grid(run.map_optimised.points, run.config.map))
    add_warnings(folder, summary, notes, failures)


def add_warnings(folder: Path, summary: dict[str, Any], notes: Sequence[str], warnings: Sequence[str]) -> None:
    """Add to a summary that is written what could not be written after it."""
    if warnings:
        summary["warnings"] += warnings
        _write_numbers(folder, summary, notes)


def _write_numbers(folder: Path, summary: dict[str, Any], notes: Sequence[str]) -> None:
    """Write the files that hold the warnings."""
    write_text(folder / "run.log", log_text(summary, notes))
    write_json(folder / "summary.json", summary)


def log_text(summary: dict[str, Any], notes: Sequence[str]) -> str:
    """The lines of run.log."""
    dataset = summary["dataset"]
    lines = [f"mqslam {summary['mqslam_version']} on {dataset['path']} ({dataset['format']})"]
    lines += [f"note: {note}" for note in notes] + [f"warning: {warning}" for warning in summary["warnings"]]
    lines.append(f"Doppler shift: {summary['doppler_beta']:.4f} s of range per closing speed")
    lines += [f"{stage}: {seconds:.2f} s" for stage, seconds in summary["runtime_s"].items()]
    lines.append(f"verdict: {summary['verdict']['status']}: {'; '.join(summary['verdict']['reasons'])}")
    return "\n".join(lines) + "\n"


def measurements_csv(measurements: Sequence[Measurement]) -> str:
    """One row per measurement; covariance of dx [m], dy [m], dyaw [rad] in the frame of the pose at t0."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(_COLUMNS)
    for m in measurements:
        upper = m.covariance[np.triu_indices(3)]
        numbers = [*m.pose, *upper, m.psi, m.psi_odometry]
        rows.writerow(
            [f"{m.t0:.6f}", f"{m.t1:.6f}", *(f"{n:.9g}" for n in numbers), m.points, f"{m.matched:.4f}", m.status.value]
        )
    return text.getvalue()
