"""psi across passes of every row of a comparison, at the same places for all of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from mqslam.backend.loops import passes
from mqslam.backend.loops.passes import TrackedRun
from mqslam.backend.refinement import SAMPLE_M, find_crossings, measure_psi_across
from mqslam.comparison.best import Best
from mqslam.comparison.judgement import JudgedRow
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.scans import Scans
from mqslam.psi.place import Beam


def measure_rows_across(
    judged: Mapping[str, JudgedRow], best: Best | None, scans: Scans, estimator: EstimatorConfig, beam: Beam, engine: Engine
) -> dict[str, float]:
    """Measures psi per point across passes of every row.

    The psi of different places cannot be compared. So one row says where a place is passed twice, and all are measured
    there: the best row, or the first of those that cannot be told apart, or the only one.

    Args:
        judged: the rows that were judged, by their names.
        best: the best of them; None for one row alone.
        scans: those that every row covers.
        estimator: settings of the score.
        beam: the sensor's errors.
        engine: where the points are scored; the result does not depend on it.

    Returns:
        psi per point by row; empty where no place is passed twice.
    """
    poses = {name: _place_scans(row, scans) for name, row in judged.items()}
    if not poses:
        return {}
    guide = best.rows[0] if best else next(iter(poses))
    drive = TrackedRun.of(scans, poses[guide])
    crossings = find_crossings(drive, SAMPLE_M, passes.LEAST_PATH_M)
    across = {}
    for name, own in poses.items():
        psi = measure_psi_across(replace(drive, poses=own), crossings, estimator, beam, engine)
        if psi is not None:
            across[name] = psi
    return across


def _place_scans(judged: JudgedRow, scans: Scans) -> se2.Array:
    """Returns the pose (len(scans), 3) of every scan under a row's trajectory."""
    assert judged.row.trajectory is not None
    return judged.row.trajectory.at(scans.stamps_us)
