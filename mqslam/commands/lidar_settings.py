"""Gives settings values that suit rooms, and finds the settings of a run that were fitted to a lidar's recording."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

from mqslam.config import Config, list_changes, load_config, set_doppler_beta
from mqslam.core.units import LIDAR_CONFIG, find_unit, fit_settings, scale_settings

ROOMS_CONFIG: Final = "rooms"
"""Name of the shipped settings with lengths that suit rooms, for audits of lidars' logs and of finished clouds."""


def fit_to_rooms(settings: Config) -> Config:
    """Replaces default values by values for rooms and lidars, for the audit of a lidar's log or of a lidar's cloud."""
    return fit_settings(fit_settings(settings, load_config(ROOMS_CONFIG), 1.0), load_config(LIDAR_CONFIG), 1.0)


@dataclass(frozen=True, slots=True)
class Changes:
    """The settings that differ between two sets, each as (name, value before, value after) with values as in JSON.

    Args:
        own: settings that somebody has changed.
        followed: settings that were fitted to a lidar's recording, and settings that are usual for lidars.
        unit_m: factor by which most lengths differ; None if there is no such factor, as in settings of radars. It is the
            unit of length of a lidar's recording [m] or, if both sets are of lidars, the ratio of their units.
    """

    own: list[tuple[str, Any, Any]]
    followed: list[tuple[str, Any, Any]]
    unit_m: float | None


def sort_changes(before: Config, after: Config) -> Changes:
    """Finds the settings that differ between two sets, and separates those that were fitted to a lidar's recording."""
    changes, unit_m = list_changes(before, after), find_unit(after, before)
    if unit_m is None:
        return Changes(changes, [], None)
    if find_unit(before, Config()) is None:
        fitted = fit_settings(before, load_config(LIDAR_CONFIG), unit_m)
        fitted = set_doppler_beta(fitted, 0.0)  # a lidar's ranges do not shift
    else:  # both are of lidars' runs
        fitted = scale_settings(before, unit_m)
    expected = {name: value for name, _, value in list_changes(before, fitted)}
    follows = [name in expected and _is_same(value, expected[name]) for name, _, value in changes]
    own = [change for change, is_followed in zip(changes, follows, strict=True) if not is_followed]
    return Changes(own, [change for change, is_followed in zip(changes, follows, strict=True) if is_followed], unit_m)


def _is_same(one: Any, other: Any) -> bool:
    """Returns whether two values of a setting are equal, floats up to rounding."""
    return bool(one == other or (isinstance(one, float) and isinstance(other, float) and math.isclose(one, other)))
