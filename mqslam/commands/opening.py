"""The recording that a command was given."""

from __future__ import annotations

from pathlib import Path

from mqslam.config import Config, load_config
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError, Remedy
from mqslam.formats.recordings import open_recording, read_odometry


def choose_settings(config: Config | Path | str | None, default: str | None = None) -> Config:
    """Returns the settings that a command was given, or the default ones.

    Args:
        config: settings, or the path of a YAML file, or the name of one that ships.
        default: what to take where there is none of them.

    Raises:
        ConfigError: no such file, or a mistake in it.
    """
    return config if isinstance(config, Config) else load_config(default if config is None else config)


def open_data(
    data: Path, format: str | None, range_resolution: float | None, settings: Config, *, strict: bool = False
) -> Recording:
    """Opens the recording that a command was given; what the command says goes before what the settings say.

    Args:
        data: the recording.
        format: name of its layout, or None to guess it.
        range_resolution: length of a range bin [m], or None.
        settings: all settings.
        strict: whether a recording with any fault is refused.

    Raises:
        ConfigError: a format nobody knows, or a range resolution that is no length.
        DataError: a recording that cannot be used, or one with any fault if strict.
    """
    sensor = settings.sensor
    resolution = range_resolution or sensor.range_resolution_m
    recording = open_recording(data, format, resolution, clockwise=sensor.clockwise, stamp=sensor.stamp)
    if strict and recording.faults:
        raise DataError(data, recording.faults[0], Remedy.LEAVE_STRICT_OUT)
    return recording


def choose_odometry(recording: Recording, choice: str) -> tuple[Trajectory | None, list[str]]:
    """Returns the odometry that a run uses, and what the user should know about the choice.

    Args:
        recording: the recording.
        choice: `auto` (the recording's own, if it has one), `none`, or the path of a file.

    Raises:
        DataError: a file that cannot be read or does not cover the recording.
    """
    if choice == "none":
        return None, []
    last = int(recording.stamps_us[-1])
    if choice != "auto":
        track = read_odometry(Path(choice))
        if not track.covers(recording.start_us, last):
            raise DataError(
                choice,
                "does not cover the recording",
                f"it must span {recording.start_us} to {last} us, in the radar's clock",
            )
        return track, []
    if recording.odometry is not None and not recording.odometry.covers(recording.start_us, last):
        return None, ["the recording's odometry does not cover it and is not used"]
    return recording.odometry, []
