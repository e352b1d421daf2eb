"""The recording that a command was given."""

from __future__ import annotations

from pathlib import Path

from mqslam.config import SensorConfig
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.recordings import open_recording, read_odometry


def opened(
    data: Path, format: str | None, range_resolution: float | None, sensor: SensorConfig, *, strict: bool = False
) -> Recording:
    """The recording at DATA, understood as options and settings say; the option goes before the setting.

    Raises:
        ConfigError: a format nobody knows, or a range resolution that is no length.
        DataError: a recording that cannot be used, or one with any fault if strict.
    """
    resolution = range_resolution or sensor.range_resolution_m
    recording = open_recording(data, format, resolution, clockwise=sensor.clockwise, stamp=sensor.stamp)
    if strict and recording.faults:
        raise DataError(data, recording.faults[0], "mend it, or leave --strict out")
    return recording


def choose_odometry(recording: Recording, choice: str) -> tuple[Trajectory | None, list[str]]:
    """The odometry a run uses, and what the user should know about the choice.

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
                choice, "does not cover the recording", f"it must span {recording.start_us} to {last} us, in the radar's clock"
            )
        return track, []
    if recording.odometry is not None and not recording.odometry.covers(recording.start_us, last):
        return None, ["the recording's odometry does not cover it and is not used"]
    return recording.odometry, []
