"""Units of length: converts tracks, measurements and settings between metres and another unit.

The method's lengths (widths of the score, spacing of keyframes, reach of loops) are chosen for a radar in streets. To a
robot with a lidar, rooms look like streets that are several times smaller. A lidar's recording is therefore solved in a
unit of length that is shorter than a metre.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from mqslam.config import Config, load_config
from mqslam.core import se2
from mqslam.core.measurement import Measurement, Refined, Tie
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory

T = TypeVar("T", bound=Tie)

LIDAR_CONFIG: Final = "lidar"
"""Name of the shipped configuration for lidars, with the settings that a recording cannot show."""

# Settings that are lengths or speeds, besides those whose names end with the unit.
_LENGTHS: Final = {
    *(("estimator", key) for key in ("s", "s_start", "beta_s", "beta_s_start")),
    *(("psi", key) for key in ("s", "beta_s", "tau")),
    ("tracker", "speed_max"),
}
_DIGITS: Final = 12  # significant digits to which ratios of lengths are rounded, since they differ by rounding errors
_NOT_LENGTHS: Final = {"range_resolution_m", "range_offset_m", "min_range_m", "max_range_m"}  # properties of the sensor


def scale_pose(pose: se2.Array, factor: float) -> se2.Array:
    """Returns poses (..., 3) x, y, yaw with x and y multiplied by a factor."""
    return np.asarray(pose * np.array([factor, factor, 1.0]))


def scale_covariance(covariance: NDArray[np.float64], factor: float) -> NDArray[np.float64]:
    """Returns the covariances (..., 3, 3) that poses x, y, yaw have once x and y are multiplied by a factor."""
    return se2.scale_covariance(covariance, np.array([factor * factor, factor * factor, 1.0]))


def scale_track(track: Trajectory, factor: float) -> Trajectory:
    """Returns a trajectory with all lengths multiplied by a factor."""
    return Trajectory(track.stamps_us, scale_pose(track.poses, factor))


def scale_measurement(motion: Measurement, factor: float) -> Measurement:
    """Returns a motion with the lengths in its pose, its covariance and its `apart` multiplied by a factor."""
    pose, apart = scale_pose(motion.pose, factor), scale_pose(motion.apart, factor)
    return replace(motion, pose=pose, covariance=scale_covariance(motion.covariance, factor), apart=apart)


def scale_tie(tie: T, factor: float) -> T:
    """Returns a tie or a loop with the lengths in its pose and its covariance multiplied by a factor."""
    return replace(tie, pose=scale_pose(tie.pose, factor), covariance=scale_covariance(tie.covariance, factor))


def scale_refined(refined: Refined, factor: float) -> Refined:
    """Returns a refinement with the lengths of its loops and ties multiplied by a factor."""
    loops, ties = ([scale_tie(tie, factor) for tie in some] for some in (refined.loops, refined.ties))
    return replace(refined, loops=loops, ties=ties)


def scale_settings(config: Config, factor: float) -> Config:
    """Multiplies lengths and speeds of settings by a factor, except properties of the sensor and settings that are None."""
    changed = {}
    for name, section in config:
        values = {key: factor * value for key, value in _list_lengths(name, section).items()}
        changed[name] = section.model_copy(update=values)
    return config.model_copy(update=changed)


def find_unit(config: Config, usual: Config) -> float | None:
    """Finds the unit of length that settings were fitted to: the given value of most lengths divided by the usual value.

    Args:
        config: settings, such as those of a lidar's run.
        usual: settings in metres.

    Returns:
        The unit [m]; None if no quotient other than 1 is shared by more than half of the lengths.
    """
    ratios = Counter[float]()
    for name, section in usual:
        given = _list_lengths(name, getattr(config, name))
        lengths = _list_lengths(name, section).items()
        ratios.update(float(f"{given[key] / value:.{_DIGITS}g}") for key, value in lengths if key in given)
    unit_m, count = ratios.most_common(1)[0]
    return unit_m if unit_m != 1.0 and 2 * count > ratios.total() else None


def _list_lengths(name: str, section: BaseModel) -> dict[str, float]:
    """Returns those settings of the section `name` that are lengths or speeds and are not None, by their names."""
    lengths = {key for key in type(section).model_fields if key.endswith("_m") or (name, key) in _LENGTHS} - _NOT_LENGTHS
    return {key: getattr(section, key) for key in lengths if getattr(section, key) is not None}


def fit_settings(config: Config, usual: Config, unit_m: float) -> Config:
    """Replaces settings that the user left at their defaults by values that suit a sensor and its unit of length.

    Args:
        config: settings as the user gave them.
        usual: settings that are usual for the sensor. Values that differ from the defaults are used as they are.
        unit_m: unit of length of the recording [m]. A length that is at its default both in `config` and in `usual`
            is multiplied by this unit.
    """
    defaults, scaled, changed = Config(), scale_settings(Config(), unit_m), {}
    for name, section in config:
        values = {}
        for key in type(section).model_fields:
            given, own, default = (getattr(one, key) for one in (section, getattr(usual, name), getattr(defaults, name)))
            if given != default:
                values[key] = given
            else:
                values[key] = own if own != default else getattr(getattr(scaled, name), key)
        changed[name] = section.model_copy(update=values)
    return config.model_copy(update=changed)


def fit_to_lidar(settings: Config, scans: Scans) -> Config:
    """Fits settings that were left at their defaults to a lidar.

    A setting that the shipped configuration `lidar` changes gets its value from there. Every other length is multiplied by
    the scans' unit of length.
    """
    return fit_settings(settings, load_config(LIDAR_CONFIG), scans.unit_m or 1.0)
