"""The charts of a run along its path."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.evaluation import measure_drift_by_length, trace_errors
from mqslam.report.content import Figure, Section
from mqslam.report.figures import path_figures
from mqslam.report.figures.canvas import BLUE, ORANGE
from mqslam.report.figures.path_figures import Curve
from mqslam.report.inputs.run_report import Report
from mqslam.report.page import section_of

_SENSORS = {"gyroscope": "gyroscope", "gnss": "GNSS", "chirps": "velocities by chirps"}


def chart_path(report: Report) -> Section | None:
    """Returns the charts along the path; None for a run of a single pose."""
    if len(report.optimised) < 2:
        return None
    charts = [
        *_chart_truth(report),
        _chart_correction(report),
        Figure(
            path_figures.draw_speed(report.optimised),
            "Speed and yaw rate",
            "of the optimised trajectory, from scan to scan",
        ),
        _chart_sigmas(report),
        _chart_contributions(report),
    ]
    return Section("Along the path", figures=tuple(chart for chart in charts if chart is not None))


def _chart_truth(report: Report) -> list[Figure]:
    """Returns error over distance and drift by length of segment, of both trajectories; none without truth."""
    if report.ground_truth is None:
        return []
    tracks = ((report.before, ORANGE, report.odometry), ("optimised", BLUE, report.optimised))
    curves, drifts = [], []
    for name, colour, track in tracks:
        errors = trace_errors(track, report.ground_truth)
        if errors is not None:
            curves.append(Curve(name, colour, *errors))
        drift = measure_drift_by_length(track, report.ground_truth)
        if drift is not None:
            drifts.append((name, colour, drift))
    charts = []
    if curves:
        caption = "distance to ground truth, on which each trajectory is laid by the best rigid motion, as evo's ape does"
        charts.append(Figure(path_figures.draw_errors(curves), "Error over distance", caption))
    if drifts:
        lengths, counts = drifts[-1][2].lengths_m, drifts[-1][2].counts
        caption = (
            f"mean error of KITTI's segments of {lengths[0]:g} m to {lengths[-1]:g} m ({counts.sum():,} of them) "
            "against ground truth"
        )
        charts.append(Figure(path_figures.draw_drift(drifts), "Drift by segment length", caption))
    return charts


def _chart_correction(report: Report) -> Figure | None:
    """Returns by how much optimisation moves each pose."""
    before = _laid_on(report.odometry, report.optimised)
    if before is None:
        return None
    after = report.optimised.poses
    apart = np.hypot(*(after[:, :2] - before[:, :2]).T)
    turned = np.unwrap(after[:, 2] - before[:, 2])
    turned -= 2.0 * np.pi * np.round(turned[0] / (2.0 * np.pi))
    picture = path_figures.draw_correction(se2.path_lengths(after), apart, turned)
    return Figure(
        picture, "Correction over distance", f"from {report.before} to the optimised trajectory, both from one start"
    )


def _laid_on(track: Trajectory, other: Trajectory) -> se2.Array | None:
    """Returns poses (N, 3) of a trajectory at the stamps of another one, from its first pose on; None if they differ."""
    if not track.covers(int(other.stamps_us[0]), int(other.stamps_us[-1]), 0):
        return None
    poses = track.at(other.stamps_us)
    return se2.compose(se2.compose(other.poses[0], se2.inverse(poses[0])), poses)


def _chart_sigmas(report: Report) -> Figure | None:
    """Returns how sure every pose is; None where that is not known."""
    if not len(report.covariances.indices):
        return None
    caption = "one standard deviation in the pose's own frame, with the first pose held fixed"
    return Figure(path_figures.draw_sigmas(report.optimised, report.covariances), "Covariance along the path", caption)


def _chart_contributions(report: Report) -> Figure | None:
    """Returns how far each sensor that is used moves the trajectory; None where none is used."""
    sensors = section_of(report.summary, "sensors")
    used: dict[str, Mapping[str, float]] = {
        name: found
        for key, name in _SENSORS.items()
        if (found := section_of(sensors, key)).get("moved_m") is not None and found.get("turned_rad") is not None
    }
    if not used:
        return None
    picture = path_figures.draw_contributions(
        {name: found["moved_m"] for name, found in used.items()},
        {name: found["turned_rad"] for name, found in used.items()},
    )
    caption = "how far the trajectory would lie elsewhere without the sensor"
    return Figure(picture, "Contribution of each sensor", caption)
