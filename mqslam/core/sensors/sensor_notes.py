"""What a run's summary says of the sensors beside the radar that is no warning."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

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
    told = f"psi per point is {before:.4f} by psi's motions alone and {after:.4f} with the sensors"
    return [f"{told}: they may bend the map; hold it against a run without {' and '.join(used)}"]
