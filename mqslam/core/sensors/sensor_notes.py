"""What a run's summary says of the sensors beside the radar that is no warning."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def list_sensor_notes(summary: Mapping[str, Any]) -> list[str]:
    """Returns what was found of the sensors that are used, and after them of where the radar sits on the vehicle.

    What is said of a sensor that is not used is a warning.

    Args:
        summary: content of summary.json; it may lack these parts.
    """
    parts = [*(summary.get("sensors") or {}).values(), summary.get("mount")]
    found = (part for part in parts if part is not None and part.get("used", True))
    return [statement for part in found for statement in part["statements"]]
