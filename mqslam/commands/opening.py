"""The recording, the settings and the odometry that a command was given."""

from __future__ import annotations

from pathlib import Path

from mqslam.config import Config, ReadingConfig, load_config
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError, Remedy
from mqslam.formats.recordings import open_recording, read_odometry


def choose_settings(config: Config | Path | str | None, default: str | None = None) -> Config:
    """Returns the settings that a command was given, or the default ones.

    Args:
        config: settings, or the path of a YAML file, or the name of one that ships with mqslam.
        default: the name to take if `config` is None.

    Raises:
        ConfigError: the file does not exist or holds a mistake.
    """
    return config if isinstance(config, Config) else load_config(default if config is None else config)


def open_data(
    data: Path, format: str | None, range_resolution: float | None, settings: Config, *, strict: bool = False
) -> Recording:
    """Opens the recording that a command was given; the command's range resolution takes precedence over the settings'.

    Args:
        data: the recording.
        format: name of its layout, or None to guess it.
        range_resolution: length of a range bin [m], or None.
        settings: all settings.
        strict: whether a recording with any fault is refused.

    Raises:
        ConfigError: the format is unknown, or the range resolution is not a length.
        DataError: the recording cannot be used, or has any fault if strict.
    """
    sensor = settings.sensor
    resolution = sensor.range_resolution_m if range_resolution is None else range_resolution
    recording = open_recording(
        data, format, resolution, clockwise=sensor.clockwise, stamp=sensor.stamp, settings=settings.reading
    )
    if strict and recording.faults:
        raise DataError(data, recording.faults[0], Remedy.LEAVE_STRICT_OUT)
    return recording


def choose_odometry(recording: Recording, choice: str, reading: ReadingConfig) -> tuple[Trajectory | None, list[str]]:
    """Returns the odometry that a run uses, and what the user should know about the choice.

    Args:
        recording: the recording.
        choice: `auto` (the recording's own, if it has one), `none`, or the path of a file.
        reading: how recordings are understood.

    Raises:
        DataError: the file cannot be read or does not cover the recording.
    """
    if choice == "none":
        return None, []
    last = int(recording.stamps_us[-1])
    if choice != "auto":
        track = read_odometry(Path(choice))
        if not track.covers(recording.start_us, last, reading.track_slack_us):
            raise DataError(
                choice,
                f"spans {track.stamps_us[0]} to {track.stamps_us[-1]} us, which does not cover the recording",
                f"give odometry that spans {recording.start_us} to {last} us in the radar's clock",
            )
        return track, []
    if recording.odometry is not None and not recording.odometry.covers(recording.start_us, last, reading.track_slack_us):
        return None, ["the recording's odometry does not cover the whole recording and is not used"]
    return recording.odometry, []
