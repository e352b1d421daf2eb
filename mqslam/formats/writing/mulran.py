"""Writes the layout MulRan: `sensor_data/radar/`, in either of its forms, and the vehicle's poses in `global_pose.csv`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mqslam.core import se2
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.execution.files import write_text
from mqslam.formats.recordings.mulran import BASE_TO_RADAR, COLUMNS, ROWS
from mqslam.formats.shared.azimuth_rows import FIRST_NS, Azimuths
from mqslam.formats.writing.azimuth_rows import azimuth_stamps, oxford_rows, write_png
from mqslam.formats.writing.columns import write_columns


def write(folder: Path, recording: Recording) -> list[str]:
    """Write a recording as polar images into an empty folder, one revolution in memory at a time.

    Returns:
        What a user should know about what was lost.

    Raises:
        DataError: a revolution that cannot be read, or that polar images cannot hold.
    """
    images = _prepared(folder, recording, COLUMNS)
    return write_columns(images, recording, [f"{end}000" for end in recording.ends_us.tolist()])


def write_rows(folder: Path, recording: Recording) -> list[str]:
    """Write a recording as Oxford rows with stamps in ns into an empty folder, one revolution in memory at a time.

    Returns:
        What a user should know about what was lost: nothing.

    Raises:
        DataError: a revolution that cannot be read or that turns counter-clockwise.
    """
    images = _prepared(folder, recording, ROWS)
    for k, polar_scan in enumerate(recording.polar_scans()):
        rows = oxford_rows(recording, k, polar_scan, per_us=1000)
        end_us = Azimuths(azimuth_stamps(recording, polar_scan), polar_scan.azimuths, polar_scan.valid).end_us
        write_png(images / f"{end_us}000.png", rows)
    return []


def _prepared(folder: Path, recording: Recording, form: str) -> Path:
    """The folder of the images, once the poses lie above it.

    Raises:
        DataError: stamps that nobody could take for nanoseconds.
    """
    if recording.start_us * 1000 <= FIRST_NS:
        problem = f"begins at {recording.start_us} us: in MulRan's ns such stamps are taken for us"
        raise DataError(recording.path, problem, "convert it to another layout")
    if recording.ground_truth is not None:
        write_text(folder / "global_pose.csv", _poses(recording.ground_truth))
    images = folder / "sensor_data" / "radar" / form
    images.mkdir(parents=True)
    return images


def _poses(truth: Trajectory) -> str:
    """Poses of the vehicle that carries the radar: stamp [ns] and a 3 x 4 matrix by rows."""
    lines = []
    vehicle = se2.compose(truth.poses, se2.inverse(BASE_TO_RADAR))
    for stamp, (x, y, yaw) in zip(truth.stamps_us.tolist(), vehicle.tolist(), strict=True):
        c, s = np.cos(yaw), np.sin(yaw)
        lines.append(f"{stamp}000,{c:.12f},{-s:.12f},0,{x:.9f},{s:.12f},{c:.12f},0,{y:.9f},0,0,1,0\n")
    return "".join(lines)
