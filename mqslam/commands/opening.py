"""The recording that a command was given."""

from __future__ import annotations

from pathlib import Path

from mqslam.config import SensorConfig
from mqslam.core.recording import RadarStream
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.recordings import open_recording, read_odometry


def opened(
    data: Path, format: str | None, range_resolution: float | None, sensor: SensorConfig, *, strict: bool = False
) -> RadarStream:
    """The recording at DATA, understood as options and settings say; the option goes before the setting.

    Raises:
        ConfigError: a format nobody knows, or a range resolution that is no length.
        DataError: a recording that cannot be used, or one with any fault if strict.
    """
    resolution = range_resolution or sensor.range_resolution_m
    stream = open_recording(data, format, resolution, clockwise=sensor.clockwise, stamp=sensor.stamp)
    if strict and stream.faults:
        raise DataError(data, stream.faults[0], "mend it, or leave --strict out")
    return stream


def choose_odometry(stream: RadarStream, choice: str) -> tuple[Trajectory | None, list[str]]:
    """The odometry a run uses, and what the user should know about the choice.

    Raises:
        DataError: a file that cannot be read or does not cover the recording.
    """
    if choice == "none":
        return None, []
    last = int(stream.stamps_us[-1])
    if choice != "auto":
        track = read_odometry(Path(choice))
        if not track.covers(stream.start_us, last):
            raise DataError(
                choice, "does not cover the recording", f"it must span {stream.start_us} to {last} us, in the radar's clock"
            )
        return track, []
    if stream.odometry is not None and not stream.odometry.covers(stream.start_us, last):
        return None, ["the recording's odometry does not cover it and is not used"]
    return stream.odometry, []
