"""Writes the results of a run: numbers as JSON and CSV, trajectories, map, graph and log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import gtsam
import numpy as np

from mqslam.auditing.gyroscope_check import GyroscopeCheck
from mqslam.auditing.verdict import verdict_of
from mqslam.auditing.windows.windows import share_torn
from mqslam.backend.marginals import PoseCovariances
from mqslam.backend.sensors.chirps import VelocityUse
from mqslam.backend.sensors.gnss import FixUse
from mqslam.backend.sensors.gyroscope import GyroscopeUse, Rotation
from mqslam.backend.sensors.mount import MountUse
from mqslam.config import dump_yaml, set_doppler_beta
from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.core.recording import LidarRecording, Recording
from mqslam.core.sensors import VEHICLE
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import list_sensor_notes
from mqslam.errors import tolerate
from mqslam.evaluation import list_errors
from mqslam.execution.files import write_json, write_text
from mqslam.execution.guards.memory import find_peak_mb
from mqslam.factors.between import CAUCHY, HUBER
from mqslam.formats.covariances import StampedCovariances, write_covariances
from mqslam.formats.graphs.g2o import format_g2o, list_edges
from mqslam.formats.maps.georeferenced import write_geojson, write_geotiff
from mqslam.formats.maps.keyframe_folder import FOLDER, write_keyframes
from mqslam.formats.maps.nav2_map import write_nav2_map
from mqslam.formats.ply import MapClock, write_ply
from mqslam.formats.tum import write_tum
from mqslam.mapping.occupancy_grid import make_occupancy_grid, mark_free
from mqslam.psi.ranging import RangeErrors
from mqslam.results.audit_results import list_unjudged, share_to_numbers, summarise_audit, summarise_tests
from mqslam.results.files import (
    TRUTH,
    add_warnings,
    format_csv,
    format_log,
    list_notes,
    list_stages,
    list_verdict,
    summarise_size,
    write_truth,
)
from mqslam.results.run_verdict import judge_run, list_unknowns
from mqslam.solution import Run, Solution
from mqslam.version import __version__

_MEASUREMENT: Final = (
    *("t0", "t1", "dx", "dy", "dyaw", "cov_xx", "cov_xy", "cov_xyaw", "cov_yy", "cov_yyaw", "cov_yawyaw"),
    *("psi", "psi_odometry", "points", "matched", "status"),
)
_EDGE: Final = ("edge", "from", "to", "kind", "loss", "parameter", "from_stamp_us", "to_stamp_us")
_STAGES: Final = ("read", "detect", "windows", "along", "loops", "refine", "optimise", "render", "check", "total")


def summarise(run: Run, recording: Recording) -> dict[str, Any]:
    """Returns the content of a run's summary.json, to which the caller adds `run_key` and the warnings."""
    before, after = run.map_odometry, run.map_optimised
    torn = share_torn(run.checks)
    truth = recording.ground_truth
    tests = judge_run(run)
    verdict = verdict_of(tests)
    return {
        "mqslam_version": __version__,
        "frontend": run.frontend,
        "before": run.before,
        "frame": recording.sensor_name if run.mount is None else VEHICLE,
        "doppler_beta": run.doppler_beta,
        "doppler_sigma": run.doppler_sigma,
        "range_errors": None if run.range_errors is None else _summarise_ranges(run.range_errors, recording),
        "range_scale": asdict(run.range_scale),
        "dataset": {
            "format": recording.format,
            "path": str(recording.path),
            **summarise_size(recording),
            "unread": len(run.unread),
            "points": len(before),
            "length_m": recording.complete(run.optimised).length_m,
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
            **share_to_numbers(torn),
            "median": float(np.median([w.bend.inflation for w in run.checks])) if run.checks else None,
        },
        **(summarise_audit(run.checked) if run.checked else {}),
        **summarise_tests(tests, run.config.verdict),
        "verdict": verdict._asdict(),
        "not_judged": [*(list_unjudged(run.checked) if run.checked else []), *list_unknowns(run, recording)],
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
        "runtime_s": {name: run.runtime_s.get(name, 0.0) for name in _STAGES},
        "peak_rss_mb": find_peak_mb(children=True),
    }


def _summarise_ranges(errors: RangeErrors, recording: Recording) -> dict[str, Any]:
    """Returns the entry `range_errors` of summary.json: the errors of the ranges as psi measured them."""
    sigmas = errors.sigmas
    return {
        "range_offset_m": recording.range_offset + errors.offset,
        "range_offset_sigma_m": float(sigmas[0]),
        "range_offset_used_m": recording.range_offset,
        "doppler_beta": errors.beta,
        "doppler_sigma": float(sigmas[1]),
        "correlation": float(errors.covariance[0, 1] / (sigmas[0] * sigmas[1])),
        "length_per_offset": errors.lengthening,
        "stretches": errors.stretches,
        "statements": errors.describe(recording.range_offset),
    }


def write_run(folder: Path, run: Run, summary: dict[str, Any], recording: Recording) -> None:
    """Writes every result file of a run except its page into an existing folder, the most valuable ones first.

    If a file such as the covariances, map or graph cannot be made, because of a fault in the code or in a library or for
    lack of memory, a warning is added to the summary, and all other files are still written.

    Args:
        folder: the folder.
        run: the finished run.
        summary: content of summary.json, with its warnings; warnings of files that could not be made are added to it.
        recording: the recording, with ground truth in the frame of the run.

    Raises:
        OutputError: a file cannot be written.
    """
    for name, track in (("trajectory.tum", run.optimised), ("odometry.tum", run.odometry)):
        write_tum(folder / name, recording.complete(track))
    write_text(folder / "measurements.csv", format_measurements(run.measurements))
    write_text(folder / "config.yaml", dump_yaml(set_doppler_beta(run.config, run.doppler_beta)))
    dataset, beta, sigma = summary["dataset"], summary["doppler_beta"], summary["doppler_sigma"]
    lines = list_notes(summary, [*recording.notes, *list_sensor_notes(summary)])
    if not isinstance(recording, LidarRecording):  # only the ranges of radars shift
        lines.append(f"Doppler shift: {beta:.4f} ± {sigma:.4f} m of range per m/s of closing speed")
    title = f"mqslam {summary['mqslam_version']} on {dataset['path']} ({dataset['format']})"
    write_text(folder / "run.log", format_log(title, [*lines, *list_stages(summary), *list_verdict(summary)]))
    write_json(folder / "summary.json", summary)
    failures: list[str] = []
    with tolerate(TRUTH, failures):
        write_truth(folder, run.optimised, recording.ground_truth)
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
        clock = MapClock(int(stamps_us[0]), scan_us, isinstance(recording, LidarRecording))
        write_ply(folder / "map.ply", run.map_optimised, clock)
    with tolerate("map.pgm", failures):
        grid = make_occupancy_grid(run.map_optimised.points, run.config.map.cell_m)
        if isinstance(recording, LidarRecording):
            grid = mark_free(grid, recording.scans, run.optimised.poses)
        write_nav2_map(folder, grid, run.georeference)
        if run.georeference is not None:
            write_geotiff(folder / "map.tif", grid, run.georeference)
    if run.georeference is not None:
        with tolerate("trajectory.geojson", failures):
            write_geojson(folder / "trajectory.geojson", run.optimised, run.georeference)
    add_warnings(folder / "summary.json", summary, failures)


def write_marginals(path: Path, trajectory: Trajectory, marginals: PoseCovariances) -> None:
    """Writes the covariances of poses in the frame of the first pose; writes no file if the covariances are not known.

    Args:
        path: the CSV file.
        trajectory: the poses.
        marginals: covariances of some or all of the poses in x, y, yaw [m, rad], each in the pose's own frame.

    Raises:
        OutputError: the file cannot be written.
    """
    if marginals.failure is not None:
        return
    yaws = trajectory.poses[marginals.indices, 2] - trajectory.poses[0, 2]
    turned = [se2.rotate_covariance(own, yaw) for own, yaw in zip(marginals.covariances, yaws.tolist(), strict=True)]
    write_covariances(path, StampedCovariances(trajectory.stamps_us[marginals.indices], np.array(turned)))


def format_measurements(measurements: Sequence[Measurement]) -> str:
    """Returns measurements as CSV: times t0 and t1 [s] and other fields of `Measurement`, in the columns `_MEASUREMENT`.

    The motion is dx [m], dy [m], dyaw [rad]. It and its covariance are in the frame of the pose at t0.
    """
    rows = []
    for m in measurements:
        numbers = [*m.pose, *m.covariance[np.triu_indices(3)], m.psi, m.psi_odometry]
        times = (f"{m.t0:.6f}", f"{m.t1:.6f}")
        cells = (*times, *(f"{n:.9g}" for n in numbers), m.points, f"{m.matched:.4f}", m.status.value)
        rows.append(dict(zip(_MEASUREMENT, cells, strict=True)))
    return format_csv(rows, _MEASUREMENT)


def format_graph_table(run: Run) -> str:
    """Returns as CSV, for each edge of graph.g2o, the properties that g2o cannot express.

    A row has the edge's number, its vertices, its kind, its robust loss with parameter, and the stamps of its scans [us].
    """
    size, stamps_us = run.graph.size, run.optimised.stamps_us.tolist()
    rows = []
    for k, factor in enumerate(list_edges(run.graph.factors)):
        keys = [(chr(gtsam.symbolChr(key)), int(gtsam.symbolIndex(key))) for key in factor.keys()]
        ends = [index if kind == "x" else size + index for kind, index in keys]  # scans first, then submaps
        loss, parameter = _describe_loss(factor.noiseModel())
        stamps = [stamps_us[end] if end < size else "" for end in ends]
        cells = (k, *ends, _name_kind(ends, size, loss), loss, parameter, *stamps)
        rows.append(dict(zip(_EDGE, cells, strict=True)))
    return format_csv(rows, _EDGE)


def _name_kind(ends: Sequence[int], size: int, loss: str) -> str:
    """Returns the kind of an edge: `measurement`, `map`, `motion`, `loop` or `refinement`.

    An edge from a submap is a `measurement` (to a scan) or a `map` (to a submap). An edge between scans is a `motion` if the
    scans are successive, a `loop` if its loss is `cauchy`, and else a tie of the `refinement`.

    Args:
        ends: numbers of the edge's two vertices. Numbers below `size` are scans, and all others are submaps.
        size: number of scans in the graph.
        loss: name of the edge's robust loss.
    """
    a, b = ends
    if a >= size:
        return "measurement" if b < size else "map"
    if b == a + 1:
        return "motion"
    return "loop" if loss == "cauchy" else "refinement"


def _describe_loss(noise: gtsam.noiseModel.Base) -> tuple[str, float | str]:
    """Returns the name of an edge's robust loss and its parameter [standard deviations]; `none` and "" without a loss."""
    if not isinstance(noise, gtsam.noiseModel.Robust):
        return "none", ""
    if isinstance(noise.robust(), gtsam.noiseModel.mEstimator.Cauchy):
        return "cauchy", CAUCHY
    return "huber", HUBER


def _describe_last_pose(run: Run) -> dict[str, Any] | None:
    """Returns the standard deviations of the last pose relative to the first: along and across its own heading, and in yaw.

    `prior_share` is the share of the position's variance that comes from the prior of the ranges' scale; 0 if GNSS measures
    the scale. The result is None if the covariance of the last pose is not known.
    """
    sure = run.covariances
    if sure.failure is not None or not len(sure.indices) or sure.indices[-1] != len(run.optimised) - 1:
        return None
    along, across, yaw = np.sqrt(np.diag(sure.covariances[-1])).tolist()
    is_placed = run.sensors.fixes is not None and run.sensors.fixes.edges is not None
    first, last = run.optimised.poses[[0, -1], :2]
    by_scale = 0.0 if is_placed else run.range_scale.prior**2 * float(np.sum((last - first) ** 2))
    share = min(by_scale / (along**2 + across**2), 1.0)
    return {"sigma_along_m": along, "sigma_across_m": across, "sigma_yaw_rad": yaw, "prior_share": share}


def summarise_sensors(run: Solution) -> dict[str, Any]:
    """Returns for gyroscope, GNSS and chirps an entry on how the sensor is used and how it changes the trajectory.

    The change is the distance by which the sensor moves the trajectory [m] (RMS) and the angle by which it turns its end
    [rad]; both are None if they are not known. The entry of a missing sensor is None.
    """
    used = run.sensors
    found: dict[str, dict[str, Any] | None] = {
        "gyroscope": None if used.gyroscope is None else _summarise_gyroscope(used.gyroscope),
        "gnss": None if used.fixes is None else _summarise_fixes(used.fixes, run),
        "chirps": None if used.velocities is None else _summarise_velocities(used.velocities),
    }
    for name, numbers in found.items():
        if numbers is not None:
            moved = used.contributions.get(name)
            numbers["moved_m"] = None if moved is None else moved.moved_m
            numbers["turned_rad"] = None if moved is None else moved.turned_rad
            if moved is not None:
                numbers["statements"].append(moved.describe(name))
    return found


def _summarise_use(use: GyroscopeUse | FixUse | VelocityUse) -> dict[str, Any]:
    """Returns the entries that all sensors have in common: source, whether readings are used, sentences for people."""
    return {"source": use.source, "used": use.edges is not None, "statements": list(use.statements)}


def summarise_mount(mount: MountUse) -> dict[str, Any]:
    """Returns the pose of the radar on the vehicle with its standard deviations; unknown numbers are NaN (null in JSON)."""
    numbers = dict(zip(("x_m", "y_m", "yaw_rad"), mount.pose.tolist(), strict=True))
    numbers |= zip(("sigma_x_m", "sigma_y_m", "sigma_yaw_rad"), mount.sigmas.tolist(), strict=True)
    return {**numbers, "source": mount.source, "statements": [mount.statement]}


def summarise_check(check: GyroscopeCheck) -> dict[str, Any]:
    """Returns the entry `gyroscope` of audit.json: the comparison of a trajectory with a gyroscope."""
    numbers: dict[str, Any] = {"source": check.source, "agrees": check.agrees, "statement": check.statement}
    numbers["differ_rad"] = check.differ_rad
    return numbers | ({} if check.rotation is None else _list_rotation(check.rotation))


def _summarise_gyroscope(use: GyroscopeUse) -> dict[str, Any]:
    """Returns the entry on a gyroscope: how it is used, and its calibration if there is one."""
    numbers = _summarise_use(use) | {"factors": 0 if use.edges is None else use.edges.count}
    return numbers | ({} if use.rotation is None else _list_rotation(use.rotation))


def _list_rotation(rotation: Rotation) -> dict[str, Any]:
    """Returns the fields of a `Rotation`, which convert a gyroscope's readings to rotations of the radar, by name."""
    return {
        "axis": rotation.axis,
        "upside_down": rotation.sign < 0.0,
        "scale": rotation.scale,
        "sigma_scale": rotation.scale_sigma,
        "late_s": rotation.delay_s,
        "sigma_late_s": rotation.delay_sigma_s,
        "bias_radps": rotation.bias,
        "white_noise": rotation.noise.white,
        "bias_walk": rotation.noise.walk,
    }


def _summarise_fixes(use: FixUse, run: Solution) -> dict[str, Any]:
    """Returns the summary's entry on GNSS: how the fixes are used and, if so, the antenna's place and the fixes' errors."""
    numbers, edges = _summarise_use(use), use.edges
    if edges is None:
        return numbers | {"factors": 0}
    if use.antenna is not None:
        numbers |= zip(("antenna_x_m", "antenna_y_m"), use.antenna.place.tolist(), strict=True)
        numbers |= zip(("sigma_antenna_x_m", "sigma_antenna_y_m"), use.antenna.sigmas.tolist(), strict=True)
    return numbers | {
        "factors": len(edges.scans),
        "rejected": edges.count_rejected(run.values),
        "white_m": edges.noise.white_m,
        "walk_m": edges.noise.walk_m,
    }


def _summarise_velocities(use: VelocityUse) -> dict[str, Any]:
    """Returns the entry on velocities that the radar's chirps measure: how they are used, and their scale and bias."""
    return _summarise_use(use) | {
        "factors": 0 if use.edges is None else len(use.edges),
        "scale": use.scale,
        "sigma_scale": use.sigma_scale,
        "bias_forward_mps": use.bias[0],
        "bias_left_mps": use.bias[1],
    }
