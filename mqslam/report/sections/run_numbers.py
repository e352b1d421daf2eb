"""The numbers of a run under the names that a reader knows them by; angles are in degrees."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from mqslam.report.content import Numbers, Table, TableRow, Values
from mqslam.report.formatting import ABSENT, format_change, format_matched, format_value
from mqslam.report.inputs.run_report import Report
from mqslam.report.page import section_of

_RADIANS: Final = " rad"
_CARDS: Final = {
    "dataset": "Recording",
    "factors": "Graph factors",
    "evaluation": "Against ground truth",
    "runtime_s": "Run time",
}
_SENSORS: Final = {
    "mount": "Radar on the vehicle",
    "gyroscope": "Gyroscope",
    "gnss": "GNSS",
    "chirps": "Velocities by chirps",
}
_LABELS: Final = {
    "chirps.factors": ("velocities in the graph", ""),
    "chirps.scale": ("travel by psi per travel by them", ""),
    "chirps.sigma_scale": ("± (one sigma)", ""),
    "chirps.bias_forward_mps": ("bias forward", " m/s"),
    "chirps.bias_left_mps": ("bias to the left", " m/s"),
    "chirps.moved_m": ("move the trajectory by (RMS)", " m"),
    "chirps.turned_rad": ("turn its end by", " rad"),
    "gyroscope.factors": ("turns in the graph", ""),
    "gyroscope.axis": ("axis that is the radar's vertical", ""),
    "gyroscope.scale": ("turns of the radar per turn of its own", ""),
    "gyroscope.sigma_scale": ("± (one sigma)", ""),
    "gyroscope.late_s": ("its clock is late by", " s"),
    "gyroscope.sigma_late_s": ("± (one sigma)", " s"),
    "gyroscope.bias_radps": ("bias", " rad/s"),
    "gyroscope.white_noise": ("white noise", " rad/s/√Hz"),
    "gyroscope.bias_walk": ("walk of the bias", " rad/s/√s"),
    "gyroscope.moved_m": ("moves the trajectory by (RMS)", " m"),
    "gyroscope.turned_rad": ("turns its end by", " rad"),
    "gnss.factors": ("fixes in the graph", ""),
    "gnss.rejected": ("of them rejected as jumps", ""),
    "gnss.white_m": ("white noise", " m"),
    "gnss.walk_m": ("walk of the error", " m/√s"),
    "gnss.antenna_x_m": ("antenna ahead of the radar", " m"),
    "gnss.antenna_y_m": ("antenna to the radar's left", " m"),
    "gnss.sigma_antenna_x_m": ("± ahead (one sigma)", " m"),
    "gnss.sigma_antenna_y_m": ("± to the left (one sigma)", " m"),
    "mount.x_m": ("ahead", " m"),
    "mount.y_m": ("to the left", " m"),
    "mount.yaw_rad": ("turned to the left", " rad"),
    "mount.sigma_x_m": ("± ahead (one sigma)", " m"),
    "mount.sigma_y_m": ("± to the left (one sigma)", " m"),
    "mount.sigma_yaw_rad": ("± turned (one sigma)", " rad"),
    "gnss.moved_m": ("moves the trajectory by (RMS)", " m"),
    "gnss.turned_rad": ("turns its end by", " rad"),
    "dataset.duration_s": ("duration", " s"),
    "dataset.length_m": ("length of path", " m"),
    "factors.loop": ("loop closures", ""),
    "factors.loop_rejected": ("loop closures rejected", ""),
    "factors.refinement": ("scans laid into earlier passes", ""),
    "evaluation.ate_rmse_m": ("ATE, RMSE", " m"),
    "evaluation.drift_percent": ("drift", " %"),
    "evaluation.drift_deg_per_100m": ("rotation drift", " °/100 m"),
    "evaluation.rpe_v_rms": ("speed error, RMS", " m/s"),
    "evaluation.rpe_w_rms": ("yaw rate error, RMS", " rad/s"),
    "evaluation.rpe_v_bias": ("speed error, mean", " m/s"),
    "evaluation.rpe_w_bias": ("yaw rate error, mean", " rad/s"),
}


def list_numbers(report: Report) -> Numbers:
    """Returns the tables at the end of a run's page."""
    cards = []
    for group, heading in _CARDS.items():
        unit = " s" if group == "runtime_s" else ""
        rows = [_label(group, key, value, unit) for key, value in section_of(report.summary, group).items()]
        if group == "runtime_s" and report.summary.get("peak_rss_mb") is not None:
            rows.append(("peak memory", format_value(report.summary["peak_rss_mb"], " MB")))
        cards.append(Values(heading, tuple(rows)))
    beside = {"mount": section_of(report.summary, "mount"), **section_of(report.summary, "sensors")}
    cards += [_list_sensor(name, found) for name, found in beside.items() if found]
    return Numbers("Map quality", _tabulate_quality(report), "", tuple(cards))


def _list_sensor(name: str, found: Mapping[str, Any]) -> Values:
    """Returns the card of the mount or of a sensor beside the radar: what was found of it, and how far it moves poses."""
    told = {key: value for key, value in found.items() if key != "statements" and value is not None}
    rows = [_label(name, key, value, "") for key, value in told.items()]
    return Values(_SENSORS[name], tuple(rows))


def _tabulate_quality(report: Report) -> Table:
    psi = section_of(report.summary, "psi")
    matched = [psi.get("matched_odometry"), psi.get("matched_optimised")]
    per_point = [psi.get("per_point_odometry"), psi.get("per_point_optimised")]
    total = [psi.get("odometry"), psi.get("optimised")]
    changes = [format_change(*pair) if all(matched) else ABSENT for pair in (total, per_point, matched)]
    lengths = (format_value(report.odometry.length_m, " m"), format_value(report.optimised.length_m, " m"))
    across = [psi.get("across_passes_odometry"), psi.get("across_passes_optimised")]
    passes: tuple[TableRow, ...] = ()
    if None not in across:
        passes = (TableRow("ψ per point across passes", (*map(format_value, across), format_change(*across))),)
    rows = (
        *passes,
        TableRow("ψ", (format_value(total[0]), format_value(total[1]), changes[0])),
        TableRow("ψ per point", (format_value(per_point[0]), format_value(per_point[1]), changes[1])),
        TableRow("points matched", (format_matched(matched[0]), format_matched(matched[1]), changes[2])),
        TableRow("points", (f"{len(report.map_odometry):,}", f"{len(report.map_optimised):,}", "")),
        TableRow("path", (*lengths, "")),
    )
    return Table(("", report.before, "optimised", "change"), rows)


def _label(group: str, key: str, value: Any, unit: str) -> tuple[str, str]:
    """Returns a value of the summary under the name that a reader knows it by."""
    label, own_unit = _LABELS.get(f"{group}.{key}", (key.replace("_", " "), unit))
    if own_unit.startswith(_RADIANS) and isinstance(value, float):
        value, own_unit = math.degrees(value), own_unit.replace(_RADIANS, " °")
    return label, format_value(value, own_unit)
