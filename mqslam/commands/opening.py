"""The recording and the odometry that a command was given."""

from __future__ import annotations

from pathlib import Path

from mqslam.config import Config
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError, Remedy
from mqslam.formats.recordings import open_recording, read_odometry


def open_data(
    data: Path, format: str | None, range_resolution: float | None, settings: Config, *, strict: bool = False
) -> Recording:
    """Opens a recording as arguments and settings say; an argument goes before the setting.

    Args:
        data: the recording.
        format: name of its layout; None guesses it.
        range_resolution: length of a range bin [m]; None takes the setting's.
        settings: all settings.
        strict: whether any fault of the recording is an error.

    Raises:
        ConfigError: the format is unknown, or the range resolution is no length.
        DataError: the recording cannot be used, or has any fault if strict.
    """
    sensor = settings.sensor
    resolution = range_resolution or sensor.range_resolution_m
    recording = open_recording(
        data, format, resolution, clockwise=sensor.clockwise, stamp=sensor.stamp, settings=settings.reading
    )
    if strict and recording.faults:
        raise DataError(data, recording.faults[0], Remedy.LEAVE_STRICT_OUT)
    return recording


def choose_odometry(recording: Recording, choice: str) -> tuple[Trajectory | None, list[str]]:
    """Chooses the odometry a run uses; returns it with what the user should know about the choice.

    Args:
        recording: the recording.
        choice: `auto` for the recording's own if it has one, `none`, or a file.

    Raises:
        DataError: the file cannot be read or does not cover the recording.
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
