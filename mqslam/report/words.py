"""Formats numbers, lengths and motions as text for the pages, and gives labels and units to the values of a summary."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core.wording import describe_left_out, left_or_right

ABSENT: Final = "–"
NOT_JUDGED: Final = "not judged"
_SMALLEST_M, _SMALLEST_RAD = 5e-4, 1e-4  # parts of a motion below these are left out, as they would be written as zero
_UNITS: Final = {
    "per_m": " per m",
    "m": " m",
    "s": " s",
    "mb": " MB",
    "percent": " %",
}  # unit by the ending of a key, the longest ending first
_LABELS: Final = {  # label and unit, by group and key or by key, where the key makes no good label; pages show degrees
    "yaw_per_m": ("yaw", " rad/m"),
    "yaw_per_m_sigma": ("yaw, sigma", " rad/m"),
    "chirps.factors": ("velocities in the graph", ""),
    "chirps.scale": ("distance by psi per distance by chirps", ""),
    "chirps.moved_m": ("move the trajectory by (RMS)", " m"),
    "chirps.turned_rad": ("turn its end by", " rad"),
    "bias_forward_mps": ("bias forward", " m/s"),
    "bias_left_mps": ("bias to the left", " m/s"),
    "gyroscope.factors": ("turns in the graph", ""),
    "gyroscope.axis": ("axis that is the radar's vertical", ""),
    "gyroscope.scale": ("turn of the radar per turn that it measures", ""),
    "sigma_scale": ("± (one sigma)", ""),
    "gyroscope.late_s": ("its clock is late by", " s"),
    "sigma_late_s": ("± (one sigma)", " s"),
    "bias_radps": ("bias", " rad/s"),
    "white_noise": ("white noise", " rad/s/√Hz"),
    "bias_walk": ("walk of the bias", " rad/s/√s"),
    "moved_m": ("moves the trajectory by (RMS)", " m"),
    "turned_rad": ("turns its end by", " rad"),
    "gnss.factors": ("fixes in the graph", ""),
    "gnss.rejected": ("fixes rejected as jumps", ""),
    "white_m": ("white noise", " m"),
    "walk_m": ("walk of the error", " m/√s"),
    "antenna_x_m": ("antenna ahead of the radar", " m"),
    "antenna_y_m": ("antenna to the radar's left", " m"),
    "sigma_antenna_x_m": ("± ahead (one sigma)", " m"),
    "sigma_antenna_y_m": ("± to the left (one sigma)", " m"),
    "mount.x_m": ("ahead", " m"),
    "mount.y_m": ("to the left", " m"),
    "mount.yaw_rad": ("turned to the left", " rad"),
    "sigma_x_m": ("± ahead (one sigma)", " m"),
    "sigma_y_m": ("± to the left (one sigma)", " m"),
    "sigma_yaw_rad": ("± turned (one sigma)", " rad"),
    "length_m": ("length of path", " m"),
    "revolutions": ("scans used", ""),
    "unread": ("scans that could not be read", ""),
    "left_out": ("scans left out, hardly moved", ""),
    "factors.loop": ("loop closures", ""),
    "factors.loop_rejected": ("loop closures rejected", ""),
    "factors.refinement": ("scans registered on earlier passes", ""),
    "over_best_of_windows": ("times the best possible in windows", ""),
    "over_best_of_passes": ("times the best possible across passes", ""),
    "ate_rmse_m": ("ATE, RMSE", " m"),
    "drift_deg_per_100m": ("rotation drift", " °/100 m"),
    "rpe_v_rms": ("speed error, RMS", " m/s"),
    "rpe_w_rms": ("yaw rate error, RMS", " rad/s"),
    "rpe_v_bias": ("speed error, mean", " m/s"),
    "rpe_w_bias": ("yaw rate error, mean", " rad/s"),
}


def list_values(group: str, values: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Returns the label and the text of each value in a part of a summary; mappings and lists in it are left out.

    Args:
        group: name of the part. Its ending, such as `_s`, gives the unit of values whose keys do not end with a unit.
        values: values of the part by their keys.
    """
    return [label_value(key, value, group) for key, value in values.items() if not isinstance(value, Mapping | list | tuple)]


def list_facts(summary: Mapping[str, Any], **others: str | None) -> list[tuple[str, str]]:
    """Returns names and texts of facts about the recording, its drive (length, duration, number of scans), and `others`.

    Args:
        summary: content of summary.json, audit.json or compare.json; facts that are not in it are left out.
        others: further facts by their names; None and empty texts are left out.
    """
    dataset = part_of(summary, "dataset")
    scans = next((dataset[key] for key in ("revolutions", "sweeps") if key in dataset), None)
    shown = ((dataset.get("length_m"), " m"), (dataset.get("duration_s"), " s"), (scans, " scans"))
    drive = [format_value(value, unit) for value, unit in shown if value is not None]
    facts = {
        "recording": f"{dataset['path']} ({dataset['format']})" if dataset else None,
        "drive": f"{', '.join(drive)}{describe_left_out(dataset)}",
        **others,
    }
    return [(name.replace("_", " "), value) for name, value in facts.items() if value]


def label_value(key: str, value: Any, group: str = "") -> tuple[str, str]:
    """Returns the label of a value of a summary, and the value as text with its unit; angles [rad] become degrees.

    Args:
        key: key of the value.
        value: the value.
        group: name of the part of the summary that holds the value.
    """
    ending = next((end for end in _UNITS if key.endswith(f"_{end}")), "")
    usual = key.removesuffix(f"_{ending}") if ending else key
    unit = _UNITS.get(ending) or next((unit for end, unit in _UNITS.items() if group.endswith(f"_{end}")), "")
    label, unit = _LABELS.get(f"{group}.{key}") or _LABELS.get(key) or (usual.replace("_", " "), unit)
    if unit.startswith(" rad") and isinstance(value, float):
        value, unit = math.degrees(value), unit.replace(" rad/m", " °/m").replace(" rad", " °")
    return label, format_value(value, unit)


def part_of(summary: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """Returns the part of a summary under a key; an empty mapping where the part is absent or None."""
    value = summary.get(key)
    return value if isinstance(value, Mapping) else {}


def format_value(value: Any, unit: str = "") -> str:
    """Returns a value of a summary as text with its unit; a dash for None, NaN and infinity.

    A float has three significant digits, or all digits before the point from 1000 on. Thousands are separated by commas.
    """
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ABSENT
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}{unit}"
    if isinstance(value, float):
        digits = f"{value:,.0f}" if abs(value) >= 1000 else f"{value:z.3g}"
        return f"{digits}{unit}"
    return f"{value}{unit}"


def format_matched(share: Any) -> str:
    """Returns the matched share (0..1) of a map's points as text in percent; `not judged` for 0, and a dash for None.

    A share of 0 does not mean a bad map: if the sensor stood still, the map holds one scan, which no other scan can match.
    """
    return NOT_JUDGED if share == 0.0 else format_value(None if share is None else 100.0 * share, " %")


def format_change(before: Any, after: Any) -> str:
    """Returns as text by how many percent a value changed; a dash if a value is None or `before` is zero."""
    if before is None or after is None or before == 0:
        return ABSENT
    return f"{100.0 * (after - before) / abs(before):+z.1f} %".replace("-", "−")


def format_length(metres: float) -> str:
    """Returns a length [m] as text: in metres with two decimals from 0.1 m on, else in whole millimetres."""
    return f"{metres:.2f} m" if metres >= 0.1 else f"{1e3 * metres:.0f} mm"


def format_p_value(p_value: float | None) -> str:
    """Returns a p-value as text with two significant digits, or `< 0.0001`; a dash for None."""
    if p_value is None:
        return ABSENT
    return "< 0.0001" if p_value < 1e-4 else f"{p_value:.2g}"


def format_three_digits(value: float) -> str:
    """Returns a number as text with three significant digits, thousands separated."""
    return f"{float(f'{value:.3g}'):z,.10g}"


def describe_place(position: NDArray[np.float64]) -> str:
    """Returns x and y of a position or pose [m] as text, in whole metres."""
    return f"({round(position[0])}, {round(position[1])}) m".replace("-", "−")


def describe_motion(motion: Iterable[float]) -> str:
    """Returns a planar motion in words: how far ahead or back, how far left or right, and by which angle to which side.

    A motion too small for words is `nowhere`.

    Args:
        motion: (3,) x [m] ahead, y [m] to the left, yaw [rad] to the left.
    """
    x, y, yaw = motion
    parts = []
    if abs(x) >= _SMALLEST_M:
        parts.append(f"{format_length(abs(x))} {'ahead' if x > 0 else 'back'}")
    if abs(y) >= _SMALLEST_M:
        parts.append(f"{format_length(abs(y))} {left_or_right(y)}")
    if abs(yaw) >= _SMALLEST_RAD:
        parts.append(f"turned {math.degrees(abs(yaw)):.2g}° {left_or_right(yaw)}")
    return ", ".join(parts) or "nowhere"
