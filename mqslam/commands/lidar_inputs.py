"""Prepares the recording of a planar lidar for a run."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from mqslam.commands.inputs import CHOICES, choose_odometry
from mqslam.config import Config, list_changes
from mqslam.core.recording import LidarRecording
from mqslam.core.sensors import RADAR, USUAL_INPUTS, Inputs
from mqslam.core.trajectory import Trajectory
from mqslam.core.units import fit_to_lidar
from mqslam.core.wording import join_words
from mqslam.detection.surfaces import prepare
from mqslam.errors import ConfigError

_OF_RADARS: Final = ("range_resolution_m", "range_offset_m", "doppler_beta", "clockwise", "stamp", "encoder_size")
"""Names of settings in section `sensor` that only radars use."""

_POSES_AS_ODOMETRY: Final = (
    "the recording has no odometry besides the poses of its scans, which are used as odometry: if a SLAM system made them, "
    "the result depends on that system (odometry none leaves them out)"
)


def prepare_lidar(
    recording: LidarRecording, settings: Config, inputs: Inputs = USUAL_INPUTS, unit_m: float | None = None
) -> tuple[LidarRecording, Trajectory | None, Config, list[str]]:
    """Prepares a lidar's recording for a run, and fits the settings to it.

    Args:
        recording: the recording as it was read.
        settings: settings as they were given.
        inputs: the choice of odometry; all other inputs must be left at their defaults or switched off.
        unit_m: unit of length of the computations [m]; None measures the unit from the ranges of the scans.

    Returns:
        (1) The recording, with scans as `mqslam.detection.surfaces.prepare` makes them. (2) The odometry that the run uses,
        or None. If a recording has no odometry and the choice is `auto`, the poses that it states for its scans are used.
        (3) All settings, with lengths that are fitted to the scans. (4) Warnings: that the odometry is not used although the
        user wants it, that poses of scans are used as odometry, and that settings have no effect on lidars.

    Raises:
        ConfigError: an input is given that only radars use.
        DataError: the file of odometry cannot be read or does not cover the recording, or no scan has a return.
    """
    given = {
        "readings of a gyroscope": inputs.imu not in CHOICES,
        "GNSS fixes": inputs.gnss not in CHOICES,
        "extrinsics": inputs.extrinsics not in CHOICES,
        "another frame than the lidar's": inputs.frame != RADAR,
    }
    if any(given.values()):
        named = join_words([name for name, is_given in given.items() if is_given])
        why = "is a lidar's recording, with which only odometry and the frame of the lidar can be used"
        raise ConfigError(f"{recording.path}: {why}; leave out {named}")
    takes_poses = inputs.odometry == "auto" and recording.odometry is None
    if takes_poses:
        recording = replace(recording, odometry=recording.trajectory)
    track, unused = choose_odometry(recording, inputs.odometry, None)
    if takes_poses and track is not None:
        unused.append(_POSES_AS_ODOMETRY)
    prepared = prepare(recording, track, unit_m)
    return prepared, track, fit_to_lidar(settings, prepared.scans), [*unused, *warn_of_idle(settings)]


def is_of_radars(name: str) -> bool:
    """Returns whether a setting, such as `detector.threshold`, has no effect on a lidar's recording."""
    section, _, key = name.partition(".")
    return section == "detector" or (section == "sensor" and key in _OF_RADARS)


def warn_of_idle(settings: Config) -> list[str]:
    """Returns a warning for a lidar's recording that names the given settings that only radars use; [] if there are none."""
    no_shift = ("sensor.doppler_beta", 0.0)  # as the config.yaml of a lidar's run states it
    changes = list_changes(Config(), settings)
    idle = [name for name, _, value in changes if is_of_radars(name) and (name, value) != no_shift]
    return [f"the recording is a lidar's, on which settings of radars have no effect: {join_words(idle)}"] if idle else []
