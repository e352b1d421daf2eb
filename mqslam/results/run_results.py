"""What a run leaves in its folder."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mqslam.config import dump_yaml, with_doppler_beta
from mqslam.core.measurement import Measurement
from mqslam.execution.files import write_text
from mqslam.formats.g2o import g2o
from mqslam.formats.nav2_map import write_nav2_map
from mqslam.formats.ply import write_ply
from mqslam.formats.tum import write_tum
from mqslam.mapping.occupancy_grid import occupancy_grid
from mqslam.slam import Run

_COLUMNS = [
    "t0", "t1", "dx", "dy", "dyaw", "cov_xx", "cov_xy", "cov_xyaw", "cov_yy", "cov_yyaw", "cov_yawyaw",
    "psi", "psi_odometry", "points", "matched", "status",
]  # fmt: skip


def write_run(folder: Path, run: Run, summary: dict[str, Any], log: str) -> None:
    """Write every result file of a run but its report into an existing folder.

    Raises:
        OutputError: a file cannot be written.
    """
    write_tum(folder / "trajectory.tum", run.optimised)
    write_tum(folder / "odometry.tum", run.odometry)
    write_text(folder / "measurements.csv", measurements_csv(run.measurements))
    write_text(folder / "graph.g2o", g2o(run.graph.factors, run.values, run.graph.size))
    write_text(folder / "config.yaml", dump_yaml(with_doppler_beta(run.config, run.doppler_beta)))
    write_ply(folder / "map.ply", run.map_optimised)
    write_nav2_map(folder, occupancy_grid(run.map_optimised.points, run.config.map.cell_m))
    write_text(folder / "run.log", log)
    write_text(folder / "summary.json", json.dumps(summary, indent=1) + "\n")


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
