"""Writes the layout Boreas: `radar/<t>.png` of Oxford rows named after their middles, poses in `applanix/`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.execution.files import write_text
from mqslam.formats.writing.azimuth_rows import azimuth_stamps, oxford_rows, write_png

_COLUMNS = "GPSTime,easting,northing,altitude,vel_east,vel_north,vel_up,roll,pitch,heading,angvel_z,angvel_y,angvel_x"


def write(folder: Path, recording: Recording) -> list[str]:
    """Write a recording into an empty folder, one revolution in memory at a time.

    An image and its pose are stamped in the middle of the revolution, at row floor(A / 2) - 1.

    Returns:
        What a user should know about what was lost.

    Raises:
        DataError: a revolution that cannot be read or that turns counter-clockwise.
    """
    for name in ("radar", "applanix"):
        (folder / name).mkdir()
    middles = np.empty(len(recording), dtype=np.int64)
    for k, polar_scan in enumerate(recording.polar_scans()):
        middles[k] = azimuth_stamps(recording, polar_scan)[len(polar_scan.times) // 2 - 1]
        write_png(folder / "radar" / f"{middles[k]}.png", oxford_rows(recording, k, polar_scan))
    return [] if recording.ground_truth is None else _write_poses(folder, recording.ground_truth, middles)


def _write_poses(folder: Path, truth: Trajectory, middles: NDArray[np.int64]) -> list[str]:
    """Write the poses of the revolutions that ground truth covers, at the stamps (N,) [us] of their images.

    The radar's frame is x forward, y right, z down in a frame of east, north and up: roll is pi and the heading the yaw.
    """
    stamps = middles[(middles >= truth.stamps_us[0]) & (middles <= truth.stamps_us[-1])]
    if len(stamps) < 2:
        return ["ground truth covers fewer than two revolutions and is left behind"]
    poses = truth.at(stamps)
    seconds = (stamps - stamps[0]) * 1e-6
    rates = np.gradient(np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])]), seconds, axis=0)
    lines = [_COLUMNS]
    for stamp, (x, y, yaw), (east, north, turn) in zip(stamps.tolist(), poses.tolist(), rates.tolist(), strict=True):
        heading = float(se2.wrap(yaw))
        lines.append(f"{stamp},{x:.9f},{y:.9f},0,{east:.6f},{north:.6f},0,{np.pi},0,{heading:.12f},{-turn:.9f},0,0")
    write_text(folder / "applanix" / "radar_poses.csv", "\n".join(lines) + "\n")
    return ["ground truth is carried to the middles of the revolutions, as Boreas has it"]
