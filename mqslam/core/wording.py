"""Words in messages: singular and plural, left and right, how sure a pose is, and what is said of sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any


def count_of(number: int, noun: str) -> str:
    """Returns a number with its noun, such as `1 scan` or `2 scans`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def join_words(words: Sequence[str]) -> str:
    """Returns words as a list with `and` before the last, such as `a, b and c`."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def is_or_are(number: int) -> str:
    """Returns the verb that goes with a number of things."""
    return "is" if number == 1 else "are"


def left_or_right(value: float) -> str:
    """Returns the side to which a positive value means left."""
    return "left" if value >= 0.0 else "right"


def list_reasons(verdict: Mapping[str, Any]) -> list[str]:
    """Returns the reasons of a verdict that a person is told besides the diagnosis: none where nothing is wrong.

    Args:
        verdict: `verdict` of a summary.
    """
    if verdict.get("status") == "pass":
        return []
    diagnosis = str(verdict.get("diagnosis", ""))
    return [str(reason) for reason in verdict.get("reasons") or () if str(reason) not in diagnosis]


def describe_last_pose(last: Mapping[str, Any] | None) -> str:
    """Returns how sure a run is of its last pose, in words.

    Args:
        last: `last_pose` of its summary.
    """
    if last is None:
        return "how sure it is, is not known"
    along, across, yaw = last["sigma_along_m"], last["sigma_across_m"], math.degrees(last["sigma_yaw_rad"])
    sure = f"± {along:.2g} m along, {across:.2g} m across, {yaw:.2g} deg heading (one sigma, seen from the first pose)"
    if not last["drift_is_prior"]:
        return sure
    return f"{sure}; no loop closes, so the drift that all motions have in common is a prior in it, not measured"


def describe_delay(delay_s: float) -> str:
    """Returns how late or early a clock is, in words."""
    return f"{abs(delay_s):.2f} s {'late' if delay_s >= 0.0 else 'early'}"


_NAMES = {"gyroscope": "the gyroscope", "gnss": "GNSS"}


def list_sensor_notes(summary: Mapping[str, Any]) -> list[str]:
    """Returns what was found of the sensors that are used, and after them of where the radar sits on the vehicle.

    What is said of a sensor that is not used is a warning.

    Args:
        summary: content of summary.json; it may lack these parts.
    """
    sensors = summary.get("sensors") or {}
    parts = [*sensors.values(), summary.get("mount")]
    found = (part for part in parts if part is not None and part.get("used", True))
    used = [_NAMES[name] for name, part in sensors.items() if name in _NAMES and part and part.get("used")]
    return [statement for part in found for statement in part["statements"]] + _doubt_sensors(summary, used)


def _doubt_sensors(summary: Mapping[str, Any], used: Sequence[str]) -> list[str]:
    """Returns that a map which is not passed was crisper before the sensors that are used joined."""
    psi = summary.get("psi") or {}
    before, after = psi.get("per_point_odometry"), psi.get("per_point_optimised")
    passed = (summary.get("verdict") or {}).get("status") == "pass"
    if not used or passed or before is None or after is None or after <= before:
        return []
    psi_of_both = f"psi per point is {before:.4f} by psi's motions alone and {after:.4f} with the sensors"
    return [f"{psi_of_both}: they may bend the map; hold it against a run without {' and '.join(used)}"]
