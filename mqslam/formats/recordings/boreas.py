"""The layouts Boreas and Boreas-RT: `radar/<t>.png` of Oxford rows, with `calib/` or `applanix/` beside it.

Source: github.com/utiasASRL/pyboreas, DATA_REFERENCE.md, DATA_RT_REFERENCE.md, pyboreas/utils. An image and its pose are
stamped in the middle of the turn (row floor(A / 2) - 1). Poses lie in `applanix/radar_poses.csv`, calibrations in `calib/`,
readings of other sensors in `applanix/` and `imu/`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.execution.files import write_text
from mqslam.execution.folders import write_folder_aside
from mqslam.formats.images import list_stamps, write_png
from mqslam.formats.poses import make_trajectory
from mqslam.formats.recordings import oxford
from mqslam.formats.recordings.azimuths import azimuth_stamps, make_rows_of_chirps
from mqslam.formats.recordings.layout import Sensing, Target
from mqslam.formats.recordings.row_images import RowImageRecording, index_rows
from mqslam.formats.sensors.datasets import (
    find_boreas_fixes,
    find_boreas_imu,
    note_unread_imu,
    read_boreas_fixes,
    read_boreas_imu,
    read_boreas_mount,
)
from mqslam.formats.sensors.reading import Carried, read_carried
from mqslam.formats.trajectories import read_beside, read_stamped

UPGRADE_US = 1_632_182_400_000_000
"""2021-09-21, when another radar was mounted."""
_RADAR = "Boreas's radar at that date"
RANGE_RESOLUTION_BEFORE_M = 0.0596
RANGE_RESOLUTION_M = 0.04381
"""Lengths of a range bin [m] that the data set publishes for the two radars."""
_COLUMNS = "GPSTime,easting,northing,altitude,vel_east,vel_north,vel_up,roll,pitch,heading,angvel_z,angvel_y,angvel_x"


def recognises(path: Path) -> bool:
    """Returns whether the path is a recording of Oxford's names with a folder `calib` or `applanix` beside the images."""
    root = oxford.find_image_folder(path).parent
    return oxford.recognises(path) and any((root / name).is_dir() for name in ("calib", "applanix"))


def open_recording(path: Path, sensing: Sensing) -> RowImageRecording:
    """Indexes a recording of Boreas: names, two images, poses and sensors are read, however long it is.

    Args:
        path: the recording.
        sensing: what the user says about the radar.

    Raises:
        DataError: there are no polar scans, or a file cannot be used.
    """
    folder = oxford.find_image_folder(path)
    images = index_rows(folder, list_stamps(folder), sensing.encoder_size)
    poses = folder.parent / "applanix" / "radar_poses.csv"
    truth, faults = read_beside(lambda: _read_poses(poses) if poses.exists() else None)
    resolution, assumed = sensing.choose_resolution(_find_resolution(int(images.stamps_us[0])), _RADAR)
    notes = [*assumed, *sensing.note_unused()]
    recording = images.to_recording(path, "boreas", resolution, ground_truth=truth, notes=notes, faults=faults)
    return _read_sensors(folder.parent).add_to(replace(recording, is_resolution_assumed=bool(assumed)))


def _read_sensors(root: Path) -> Carried:
    """Reads the sensors of a recording whose folder is `root`."""
    imu = find_boreas_imu(root)
    return read_carried(
        lambda: read_boreas_imu(imu) if imu else None,
        lambda: read_boreas_fixes(header) if (header := find_boreas_fixes(root)) else None,
        lambda: read_boreas_mount(root / "calib"),
        note_unread_imu(root),
    )


def _find_resolution(start_us: int) -> float:
    """Returns the length of a range bin [m] of the radar that was mounted at a stamp [us]."""
    return RANGE_RESOLUTION_BEFORE_M if start_us < UPGRADE_US else RANGE_RESOLUTION_M


def _read_poses(file: Path) -> Trajectory:
    """Reads the poses of the radar, x forward, y right, z down, in a frame of east, north and up, as planar REP 103.

    Columns: stamp, easting, northing, altitude [m], three velocities, roll, pitch, heading [rad], three rates; and
    C_enu_radar = R1(roll) R2(pitch) R3(heading), where R turn the axes, not the vectors. Roll is near pi, so the heading
    goes counter-clockwise from east as yaw does; exactly, the yaw is where the radar's x axis points.
    """
    stamps, table = read_stamped(file, [1, 2, 7, 8, 9])
    easting, northing, roll, pitch, heading = table.T
    east = np.cos(pitch) * np.cos(heading)
    north = np.sin(roll) * np.sin(pitch) * np.cos(heading) - np.cos(roll) * np.sin(heading)
    return make_trajectory(file, stamps, np.column_stack([easting, northing, np.arctan2(north, east)]))


def write(out: Path, recording: Recording) -> list[str]:
    """Writes a recording as a folder, whole or not at all, one polar scan in memory at a time.

    Returns:
        Notes for the user on what was lost.

    Raises:
        DataError: a polar scan cannot be read, or turns counter-clockwise.
        OutputError: the folder cannot be written.
    """
    middles = np.empty(len(recording), dtype=np.int64)
    with write_folder_aside(out) as folder:
        for name in ("radar", "applanix"):
            (folder / name).mkdir()
        for k, polar_scan in enumerate(recording.polar_scans()):
            middles[k] = azimuth_stamps(recording, polar_scan)[len(polar_scan.times) // 2 - 1]
            write_png(folder / "radar" / f"{middles[k]}.png", make_rows_of_chirps(recording, k, polar_scan))
        return [] if recording.ground_truth is None else _write_poses(folder, recording.ground_truth, middles)


def _write_poses(folder: Path, truth: Trajectory, middles: NDArray[np.int64]) -> list[str]:
    """Writes the poses of the polar scans that ground truth covers, at the stamps (N,) [us] of their images.

    The radar's frame is x forward, y right, z down in a frame of east, north and up: roll is pi and the heading the yaw.
    """
    stamps = middles[(middles >= truth.stamps_us[0]) & (middles <= truth.stamps_us[-1])]
    if len(stamps) < 2:
        return ["ground truth covers fewer than two polar scans and is left behind"]
    poses = truth.at(stamps)
    seconds = (stamps - stamps[0]) * 1e-6
    rates = np.gradient(np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])]), seconds, axis=0)
    lines = [_COLUMNS]
    for stamp, (x, y, yaw), (east, north, turn) in zip(stamps.tolist(), poses.tolist(), rates.tolist(), strict=True):
        heading = float(se2.wrap(yaw))
        lines.append(f"{stamp},{x:.9f},{y:.9f},0,{east:.6f},{north:.6f},0,{np.pi},0,{heading:.12f},{-turn:.9f},0,0")
    write_text(folder / "applanix" / "radar_poses.csv", "\n".join(lines) + "\n")
    return ["ground truth is carried to the middles of the turns, as Boreas has it"]


TARGETS = (Target("boreas", write, assumed_resolution=lambda recording: _find_resolution(recording.start_us)),)
