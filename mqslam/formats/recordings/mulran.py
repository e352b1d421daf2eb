"""The layout MulRan: polar images under `sensor_data/radar/`, in one of two forms or both.

`polar/<t>.png` has one column per azimuth and no metadata; `polar_oxford_form/<t>.png` has Oxford rows, with stamps in ns
like the names. An image is stamped at the end of its turn. The poses of the vehicle lie in `global_pose.csv`, the readings
of its sensors in `xsens_imu.csv` and `gps.csv`.

Source: sites.google.com/view/mulran-pr; github.com/url-kaist/outlier-robust-radar-odometry (ORORA), which states the stamp
and the calibration.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from mqslam.core import se2
from mqslam.core.recording import Recording
from mqslam.core.sensors import Mount
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.execution.files import write_text
from mqslam.execution.folders import write_folder_aside
from mqslam.formats.odometry_files import read_beside, read_stamped
from mqslam.formats.recordings.column_images import ColumnImages, open_columns, write_columns
from mqslam.formats.sensors.carried import Carried, read_carried
from mqslam.formats.sensors.mulran_sensors import GPS_NAME, IMU_NAME, find_mulran_file, read_mulran_fixes, read_mulran_imu
from mqslam.formats.sensors.sensor_table import read_header
from mqslam.formats.shared.azimuth_rows import FIRST_NS, Azimuths, azimuth_stamps, make_rows, stamps_in_us
from mqslam.formats.shared.images import list_stamps, write_png
from mqslam.formats.shared.poses import make_trajectory
from mqslam.formats.shared.row_images import index_rows
from mqslam.formats.shared.sensing import Sensing
from mqslam.formats.shared.target import Target

_RADAR = "MulRan's radar"
RANGE_RESOLUTION_M = 0.0595  # published with the data set
_ROWS, _COLUMNS = "polar_oxford_form", "polar"
_BASE_TO_RADAR = (1.50, -0.04, float(np.deg2rad(0.9)))
"""Pose of the radar on the vehicle [m, m, rad]: calib_base2radar.txt of the dataset, of which z is left out."""
_MOUNT_SOURCE = "the calibration that MulRan publishes, since no file of a recording states it"


def recognises(path: Path) -> bool:
    """Returns whether the path holds images in one of the two forms, or is the folder of one."""
    return any(_list_folders(path))


def open_recording(path: Path, sensing: Sensing) -> Recording:
    """Indexes a recording of MulRan: names, two images, poses and sensors are read, however long it is.

    Rows with own stamps are preferred to columns without.

    Args:
        path: the recording.
        sensing: what the user says about the radar.

    Raises:
        DataError: there are no polar scans, or a file cannot be used.
    """
    folder = next(_list_folders(path), None)
    if folder is None:
        remedy = f"give the folder that holds sensor_data/radar/{_COLUMNS} or {_ROWS}"
        raise DataError(path, "holds no radar images of MulRan", remedy)
    poses = find_mulran_file(folder, "global_pose.csv")
    truth, faults = read_beside(lambda: _read_poses(poses) if poses else None)
    names = list_stamps(folder)
    if folder.resolve().name == _ROWS:
        resolution, assumed = sensing.choose_resolution(RANGE_RESOLUTION_M, _RADAR)
        notes = [*assumed, *sensing.note_unused()]
        images = index_rows(folder, names, sensing.encoder_size)
        rows = images.to_recording(path, "mulran", resolution, ground_truth=truth, notes=notes, faults=faults)
        return _read_sensors(folder).add_to(replace(rows, is_resolution_assumed=bool(assumed)))
    columns = ColumnImages(folder, names)
    usual = RANGE_RESOLUTION_M, _RADAR
    recording = open_columns(path, "mulran", columns, stamps_in_us(names), None, usual, sensing)
    return _read_sensors(folder).add_to(replace(recording, ground_truth=truth, faults=(*faults, *recording.faults)))


def _read_sensors(images: Path) -> Carried:
    """Reads the sensors of the recording whose images lie in a folder."""
    imu, gps = find_mulran_file(images, IMU_NAME), find_mulran_file(images, GPS_NAME)
    return read_carried(
        lambda: read_mulran_imu(read_header(imu, "repair or remove it")) if imu else None,
        lambda: read_mulran_fixes(read_header(gps, "repair or remove it")) if gps else None,
        lambda: Mount(np.array(_BASE_TO_RADAR), _MOUNT_SOURCE),
    )


def _list_folders(path: Path) -> Iterator[Path]:
    """Lists the folders of images in and above which the path may be, the ones with own stamps first."""
    for form in (_ROWS, _COLUMNS):
        inside = (path / "sensor_data" / "radar" / form, path / "radar" / form, path / form)
        for folder in (*inside, path) if path.resolve().name == form else inside:
            if any(image.stem.isdecimal() for image in folder.glob("*.png")):
                yield folder


def _read_poses(file: Path) -> Trajectory:
    """Reads the vehicle's poses, stamp [ns] and a 3 x 4 matrix by rows in REP 103, and carries them to the radar."""
    stamps, table = read_stamped(file, [1, 4, 5, 8])
    cosine, x, sine, y = table.T
    vehicle = np.column_stack([x, y, np.arctan2(sine, cosine)])
    return make_trajectory(file, stamps, se2.compose(vehicle, _BASE_TO_RADAR))


def write(out: Path, recording: Recording) -> list[str]:
    """Writes a recording as a folder of polar images, whole or not at all, one polar scan in memory at a time.

    Returns:
        Notes for the user on what was lost.

    Raises:
        DataError: a polar scan cannot be read, or polar images cannot hold it.
        OutputError: the folder cannot be written.
    """
    with write_folder_aside(out) as folder:
        images = _prepare_folder(folder, recording, _COLUMNS)
        return write_columns(images, recording, [f"{end}000" for end in recording.ends_us.tolist()])


def write_rows(out: Path, recording: Recording) -> list[str]:
    """Writes a recording as a folder of Oxford rows, whole or not at all, one polar scan in memory at a time.

    Returns:
        Notes for the user on what was lost: none.

    Raises:
        DataError: a polar scan cannot be read, or turns counter-clockwise.
        OutputError: the folder cannot be written.
    """
    with write_folder_aside(out) as folder:
        images = _prepare_folder(folder, recording, _ROWS)
        for k, polar_scan in enumerate(recording.polar_scans()):
            rows = make_rows(recording, k, polar_scan, per_us=1000)
            end_us = Azimuths(azimuth_stamps(recording, polar_scan), polar_scan.azimuths, polar_scan.valid).end_us
            write_png(images / f"{end_us}000.png", rows)
    return []


def _prepare_folder(folder: Path, recording: Recording, form: str) -> Path:
    """Makes the folder of the images and writes the poses above it; returns the folder.

    Raises:
        DataError: the recording's stamps could not be recognised as nanoseconds.
    """
    if recording.start_us * 1000 <= FIRST_NS:
        problem = f"begins at {recording.start_us} us: in MulRan's ns such stamps are taken for us"
        raise DataError(recording.path, problem, "convert it to another layout")
    if recording.ground_truth is not None:
        write_text(folder / "global_pose.csv", _format_poses(recording.ground_truth))
    images = folder / "sensor_data" / "radar" / form
    images.mkdir(parents=True)
    return images


def _format_poses(truth: Trajectory) -> str:
    """Formats the poses of the vehicle that carries the radar: stamp [ns] and a 3 x 4 matrix by rows."""
    lines = []
    vehicle = se2.compose(truth.poses, se2.inverse(_BASE_TO_RADAR))
    for stamp, (x, y, yaw) in zip(truth.stamps_us.tolist(), vehicle.tolist(), strict=True):
        c, s = np.cos(yaw), np.sin(yaw)
        lines.append(f"{stamp}000,{c:.12f},{-s:.12f},0,{x:.9f},{s:.12f},{c:.12f},0,{y:.9f},0,0,1,0\n")
    return "".join(lines)


TARGETS = (
    Target("mulran", write, validity=False, assumed_resolution=lambda _: RANGE_RESOLUTION_M),
    Target("mulran_oxford", write_rows, assumed_resolution=lambda _: RANGE_RESOLUTION_M),
)
