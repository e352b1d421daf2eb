"""What a run leaves: its numbers as JSON and CSV, its trajectories, its map, its graph and its log."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from mqslam.auditing.verdict import CONFIDENCE
from mqslam.auditing.windows.windows import share_torn
from mqslam.backend.marginals import PoseCovariances
from mqslam.backend.pose_graph import count_submaps
from mqslam.config import dump_yaml, set_doppler_beta
from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.core.recording import Recording
from mqslam.core.sensors import RADAR, VEHICLE
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import list_sensor_notes
from mqslam.errors import tolerate
from mqslam.evaluation import list_errors
from mqslam.execution.files import write_json, write_text
from mqslam.execution.guards.memory import find_peak_mb
from mqslam.formats.covariances import StampedCovariances, write_covariances
from mqslam.formats.graphs.g2o import format_g2o
from mqslam.formats.maps.georeferenced import write_geojson, write_geotiff
from mqslam.formats.maps.keyframe_folder import FOLDER, write_keyframes
from mqslam.formats.maps.nav2_map import write_nav2_map
from mqslam.formats.ply import MapClock, write_ply
from mqslam.formats.tum import write_tum
from mqslam.mapping.occupancy_grid import make_occupancy_grid
from mqslam.results.audit_results import summarise_tests
from mqslam.results.graph_table import format_graph_table
from mqslam.results.run_log import format_log, list_stages, list_verdict
from mqslam.results.run_scale import list_unknown_scale
from mqslam.results.run_verdict import judge_run
from mqslam.results.sensor_results import summarise_mount, summarise_sensors
from mqslam.results.truth_files import TRUTH, write_truth
from mqslam.results.unjudged import list_unjudged
from mqslam.solution import Run
from mqslam.version import __version__

_COLUMNS: Final = [
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


def summarise(run: Run, recording: Recording) -> dict[str, Any]:
    """Returns the content of summary.json, but for the run's key and its warnings."""
    before, after = run.map_odometry, run.map_optimised
    torn = share_torn(run.checks)
    truth = recording.ground_truth
    status, reasons = judge_run(run)
    return {
        "mqslam_version": __version__,
        "frontend": run.frontend,
        "before": run.before,
        "frame": RADAR if run.mount is None else VEHICLE,
        "doppler_beta": run.doppler_beta,
        "doppler_sigma": run.doppler_sigma,
        "dataset": {
            "format": recording.format,
            "path": str(recording.path),
            "revolutions": len(recording),
            "unread": len(run.unread),
            "duration_s": recording.duration_s,
            "length_m": run.optimised.length_m,
        },
        "psi": {
            "odometry": before.psi_total,
            "optimised": after.psi_total,
            "per_point_odometry": before.psi_per_point,
            "per_point_optimised": after.psi_per_point,
            "across_passes_odometry": run.refined.psi_before,
            "across_passes_optimised": run.refined.psi_across,
            "matched_odometry": before.matched_share,
            "matched_optimised": after.matched_share,
        },
        "inflation": {
            "windows": torn.total,
            "torn": torn.count,
            "torn_share_at_least": torn.lower_bound(CONFIDENCE),
            "torn_share_at_most": torn.upper_bound(CONFIDENCE),
            "median": float(np.median([w.bend.inflation for w in run.checks])) if run.checks else None,
        },
        **(summarise_tests(run.checked, run.config.verdict) if run.checked else {}),
        "verdict": {"status": status, "reasons": reasons},
        "not_judged": [*(list_unjudged(run.checked) if run.checked else []), *list_unknown_scale(run, recording)],
        "last_pose": _describe_last_pose(run),
        "factors": {
            "odometry": run.odometry_factors,
            "psi": len(run.measurements),
            "loop": len(run.loops),
            "loop_rejected": run.loops_rejected,
            "refinement": len(run.refined.ties),
        },
        "sensors": summarise_sensors(run),
        "mount": None if run.sensors.mount is None else summarise_mount(run.sensors.mount),
        "evaluation": list_errors(run.optimised, truth),
        "evaluation_odometry": list_errors(run.odometry, truth),
        "runtime_s": {
            name: run.runtime_s.get(name, 0.0)
            for name in ("read", "detect", "windows", "along", "loops", "refine", "optimise", "render", "check", "total")
        },
        "peak_rss_mb": find_peak_mb(children=True),
    }


def write_run(folder: Path, run: Run, summary: dict[str, Any], notes: Sequence[str], truth: Trajectory | None) -> None:
    """Writes every result file of a run but its page into an existing folder, the most valuable ones first.

    Covariances, map and graph may fail, by a fault of theirs or of a library or for want of memory. That is a warning,
    which is added to those of the summary, and all other files are written.

    Args:
        folder: the folder.
        run: the finished run.
        summary: content of summary.json, with its warnings.
        notes: what a user should know about how the recording was understood, for run.log.
        truth: ground truth in the frame of the run, or None.

    Raises:
        OutputError: a file cannot be written.
    """
    write_tum(folder / "trajectory.tum", run.optimised)
    write_tum(folder / "odometry.tum", run.odometry)
    write_text(folder / "measurements.csv", format_measurements(run.measurements))
    write_text(folder / "config.yaml", dump_yaml(set_doppler_beta(run.config, run.doppler_beta)))
    _write_numbers(folder, summary, notes)
    failures: list[str] = []
    with tolerate(TRUTH, failures):
        write_truth(folder, run.optimised, truth)
    with tolerate("covariances.csv", failures):
        write_marginals(folder / "covariances.csv", run.optimised, run.covariances)
    with tolerate("graph.g2o", failures):
        write_text(folder / "graph.g2o", format_g2o(run.graph.factors, run.values, run.graph.size))
        write_text(folder / "graph.csv", format_graph_table(run))
    if run.kept is not None:
        with tolerate(FOLDER, failures):
            write_keyframes(folder / FOLDER, run.kept.place_on_earth(run.georeference))
    with tolerate("map.ply", failures):
        stamps_us = run.optimised.stamps_us
        scan_us = int(np.median(np.diff(stamps_us))) if len(stamps_us) > 1 else 0
        write_ply(folder / "map.ply", run.map_optimised, MapClock(int(stamps_us[0]), scan_us))
    with tolerate("map.pgm", failures):
        grid = make_occupancy_grid(run.map_optimised.points, run.config.map.cell_m)
        write_nav2_map(folder, grid, run.georeference)
        if run.georeference is not None:
            write_geotiff(folder / "map.tif", grid, run.georeference)
    if run.georeference is not None:
        with tolerate("trajectory.geojson", failures):
            write_geojson(folder / "trajectory.geojson", run.optimised, run.georeference)
    add_warnings(folder, summary, notes, failures)


def add_warnings(folder: Path, summary: dict[str, Any], notes: Sequence[str], warnings: Sequence[str]) -> None:
    """Adds to a summary and a log that are written already what could not be written after them.

    Args:
        folder: the folder of the results.
        summary: content of summary.json, to which the warnings are added.
        notes: what a user should know about how the recording was understood.
        warnings: what could not be written, and why.

    Raises:
        OutputError: a file cannot be written.
    """
    if warnings:
        summary["warnings"] += warnings
        _write_numbers(folder, summary, notes)


def write_marginals(path: Path, trajectory: Trajectory, marginals: PoseCovariances) -> None:
    """Writes the covariances of all poses in the frame of the first one; nothing where they are not known.

    Args:
        path: the file.
        trajectory: the poses.
        marginals: their covariances in their own frames.

    Raises:
        OutputError: the file cannot be written.
    """
    if marginals.failure is not None:
        return
    yaws = trajectory.poses[marginals.indices, 2] - trajectory.poses[0, 2]
    turned = [se2.rotate_covariance(own, yaw) for own, yaw in zip(marginals.covariances, yaws.tolist(), strict=True)]
    write_covariances(path, StampedCovariances(trajectory.stamps_us[marginals.indices], np.array(turned)))


def format_measurements(measurements: Sequence[Measurement]) -> str:
    """Returns a row per measurement, with the covariance of dx [m], dy [m], dyaw [rad] in the frame of the pose at t0."""
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


def _write_numbers(folder: Path, summary: dict[str, Any], notes: Sequence[str]) -> None:
    """Writes the files that hold the warnings."""
    write_text(folder / "run.log", _log_text(summary, notes))
    write_json(folder / "summary.json", summary)


def _log_text(summary: dict[str, Any], notes: Sequence[str]) -> str:
    dataset = summary["dataset"]
    lines = [f"note: {note}" for note in (*notes, *list_sensor_notes(summary))]
    lines += [f"warning: {warning}" for warning in summary["warnings"]]
    beta, sigma = summary["doppler_beta"], summary["doppler_sigma"]
    lines.append(f"Doppler shift: {beta:.4f} ± {sigma:.4f} m of range per m/s of closing speed")
    lines += [*list_stages(summary), *list_verdict(summary)]
    return format_log(f"mqslam {summary['mqslam_version']} on {dataset['path']} ({dataset['format']})", lines)


def _describe_last_pose(run: Run) -> dict[str, Any] | None:
    """Returns how sure the run is of its last pose in the frame of the first; None where the covariances are not known.

    What the pieces of the map drift in common is a prior, unless a loop or GNSS measures it.
    """
    sure = run.covariances
    if sure.failure is not None or not len(sure.indices) or sure.indices[-1] != len(run.optimised) - 1:
        return None
    along, across, yaw = np.sqrt(np.diag(sure.covariances[-1])).tolist()
    pieces = count_submaps(run.values)  # two are tied by how far the running map may drift
    is_placed = run.sensors.fixes is not None and run.sensors.fixes.edges is not None
    drift_is_prior = pieces > 1 and not run.loops and not is_placed
    return {"sigma_along_m": along, "sigma_across_m": across, "sigma_yaw_rad": yaw, "drift_is_prior": drift_is_prior}
