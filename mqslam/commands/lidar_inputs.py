"""Prepares a lidar's recording for a run, and fits the settings to a lidar."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from mqslam.commands.inputs import USUAL_INPUTS, Inputs, choose_odometry
from mqslam.config import Config, load_config
from mqslam.core.recording import LidarRecording
from mqslam.core.scans import Scans
from mqslam.core.sensors import RADAR
from mqslam.core.trajectory import Trajectory
from mqslam.core.units import fit_settings
from mqslam.core.wording import join_words
from mqslam.detection.surfaces import prepare
from mqslam.errors import ConfigError

LIDAR_CONFIG: Final = "lidar"
"""Name of the shipped settings for lidars."""
ROOMS_CONFIG: Final = "rooms"
"""Name of the shipped settings whose lengths suit rooms; audits of lidars' logs and of finished clouds use them."""
_OFF = ("auto", "none")  # choices of an input that name no file and no values


@dataclass(frozen=True, slots=True)
class PreparedLidar:
    """A lidar's recording that is ready for a run, with its odometry and settings.

    Args:
        recording: the recording, with scans as `mqslam.detection.surfaces.prepare` makes them.
        odometry: its odometry, or None.
        settings: the settings, with lengths that are fitted to the scans.
        warnings: why odometry is not used, if it is not.
    """

    recording: LidarRecording
    odometry: Trajectory | None
    settings: Config
    warnings: tuple[str, ...]


def prepare_lidar(
    recording: LidarRecording, settings: Config, inputs: Inputs = USUAL_INPUTS, unit_m: float | None = None
) -> PreparedLidar:
    """Prepares a lidar's recording for a run, and fits the settings to it.

    Args:
        recording: the recording as it was read.
        settings: settings as they were given.
        inputs: the choice of odometry; all other inputs must be left at their defaults or switched off.
        unit_m: the unit of length of the computations [m]; None measures it from the scans.

    Raises:
        ConfigError: an input is given that only radars use.
        DataError: the odometry's file cannot be read or does not cover the recording.
    """
    given = {
        "readings of a gyroscope": inputs.imu not in _OFF,
        "GNSS fixes": inputs.gnss not in _OFF,
        "extrinsics": inputs.extrinsics not in _OFF,
        "another frame than the lidar's": inputs.frame != RADAR,
    }
    if any(given.values()):
        named = join_words([name for name, is_given in given.items() if is_given])
        why = "is a lidar's recording, whose poses are the lidar's and whose only other sensor can be odometry"
        raise ConfigError(f"{recording.path}: {why}; leave out {named}")
    track, unused = choose_odometry(recording, inputs.odometry, None)
    prepared = prepare(recording, track, unit_m)
    return PreparedLidar(prepared, track, fit_to_lidar(settings, prepared.scans), tuple(unused))


def fit_to_lidar(settings: Config, scans: Scans) -> Config:
    """Fits settings to the scans of a lidar: lengths that were left at their defaults are multiplied by the scans' unit."""
    return fit_settings(settings, load_config(LIDAR_CONFIG), scans.unit_m or 1.0)


def fit_to_rooms(settings: Config) -> Config:
    """Fits settings to the audit of a lidar's log or a finished cloud: usual lengths for rooms replace the defaults."""
    return fit_settings(fit_settings(settings, load_config(ROOMS_CONFIG), 1.0), load_config(LIDAR_CONFIG), 1.0)
