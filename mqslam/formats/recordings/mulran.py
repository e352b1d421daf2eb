"""Reads and writes the layout MulRan: polar images under `sensor_data/radar/`, in one of two forms or both.

An image `polar/<t>.png` has one column per azimuth and no metadata. An image `polar_oxford_form/<t>.png` has Oxford rows:
the time [ns], angle and power of one azimuth each (see `azimuths`). The name <t> of an image is the stamp of the end of its
revolution [ns]. The poses of the vehicle lie in `global_pose.csv`, the readings of its sensors in `xsens_imu.csv` and
`gps.csv`.

Source: sites.google.com/view/mulran-pr; github.com/url-kaist/outlier-robust-radar-odometry (ORORA), which states the stamp
and the calibration.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mqslam.core import se2
from mqslam.core.recording import Recording
from mqslam.core.sensors import Mount
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.execution.files import write_text
from mqslam.execution.folders import write_folder_aside
from mqslam.formats.images import list_stamps, write_png
from mqslam.formats.poses import make_trajectory
from mqslam.formats.recordings.azimuths import FIRST_NS, Azimuths, azimuth_stamps, make_rows, stamps_in_us
from mqslam.formats.recordings.column_images import ColumnImages, open_columns, write_columns
from mqslam.formats.recordings.layout import Sensing, Target
from mqslam.formats.recordings.row_images import open_rows
from mqslam.formats.sensors.csv_files import read_fixes_table, read_gyroscope_table
from mqslam.formats.sensors.reading import add_beside
from mqslam.formats.tables import read_stamped

RANGE_RESOLUTION_M = 0.0595  # published with the data set
_ROWS, _COLUMNS = "polar_oxford_form", "polar"
_BASE_TO_RADAR = (1.50, -0.04, float(np.deg2rad(0.9)))
"""Pose of the radar on the vehicle [m, m, rad]: from calib_base2radar.txt of the dataset, without z."""
_MOUNT = Mount(np.array(_BASE_TO_RADAR), "the calibration that MulRan publishes, since no file of a recording states it")


def recognises(path: Path) -> bool:
    """Returns whether a path holds images in a folder `polar` or `polar_oxford_form`, or is itself such a folder."""
    return any(_list_folders(path))


def open_recording(path: Path, sensing: Sensing) -> Recording:
    """Indexes a recording of MulRan: reads the names of the images, a few of the images, the poses and the other sensors.

    If a recording has both column images and Oxford rows, the Oxford rows are read, since their azimuths carry stamps.
    """
    folder = next(_list_folders(path), None)
    if folder is None:
        remedy = f"give the folder that holds sensor_data/radar/{_COLUMNS} or {_ROWS}"
        raise DataError(path, "holds no radar images of MulRan", remedy)
    names = list_stamps(folder)
    bin_length = sensing.choose_resolution(RANGE_RESOLUTION_M, "MulRan's radar")
    recording: Recording
    if folder.resolve().name == _ROWS:
        recording = open_rows(path, "mulran", folder, names, bin_length, sensing)
    else:
        images = ColumnImages(folder, names)
        recording = open_columns(path, "mulran", images, stamps_in_us(names), None, bin_length, sensing)
    poses, imu, gps = (
        next((file for above in folder.resolve().parents[:3] if (file := above / name).exists()), None)
        for name in ("global_pose.csv", "xsens_imu.csv", "gps.csv")
    )
    return add_beside(
        recording,
        lambda: read_gyroscope_table(imu) if imu else None,
        lambda: read_fixes_table(gps) if gps else None,
        lambda: _MOUNT,
        truth=lambda: _read_poses(poses) if poses else None,
    )


def _list_folders(path: Path) -> Iterator[Path]:
    """Yields the folders with images at or below a path; a folder with Oxford rows comes first."""
    for form in (_ROWS, _COLUMNS):
        inside = (path / "sensor_data" / "radar" / form, path / "radar" / form, path / form)
        for folder in (*inside, path) if path.resolve().name == form else inside:
            if any(image.stem.isdecimal() for image in folder.glob("*.png")):
                yield folder


def _read_poses(file: Path) -> Trajectory:
    """Reads the poses of the vehicle, and converts them to poses of the radar.

    A line holds a stamp [ns] and the pose as the rows of a 3 x 4 matrix [m], in the axes of REP 103.
    """
    stamps, table = read_stamped(file, [1, 4, 5, 8])
    cosine, x, sine, y = table.T
    vehicle = np.column_stack([x, y, np.arctan2(sine, cosine)])
    return make_trajectory(file, stamps, se2.compose(vehicle, _BASE_TO_RADAR))


def write(out: Path, recording: Recording) -> list[str]:
    """Writes a recording as a folder of polar images, as `Target.write` describes it."""
    with write_folder_aside(out) as folder:
        images = _prepare_folder(folder, recording, _COLUMNS)
        return write_columns(images, recording, [f"{end}000" for end in recording.ends_us.tolist()])


def write_rows(out: Path, recording: Recording) -> list[str]:
    """Writes a recording as a folder of images of Oxford rows, as `Target.write` describes it."""
    with write_folder_aside(out) as folder:
        images = _prepare_folder(folder, recording, _ROWS)
        for k, polar_scan in enumerate(recording.polar_scans()):
            rows = make_rows(recording, k, polar_scan, per_us=1000)
            end_us = Azimuths(azimuth_stamps(recording, polar_scan), polar_scan.azimuths, polar_scan.valid).end_us
            write_png(images / f"{end_us}000.png", rows)
    return []


def _prepare_folder(folder: Path, recording: Recording, form: str) -> Path:
    """Makes and returns the folder, called `form`, for images; writes the ground truth, if any, beside `sensor_data/`.

    Raises:
        DataError: the recording begins so early that its stamps in ns would be read as us.
    """
    if recording.start_us * 1000 <= FIRST_NS:
        problem = f"begins at {recording.start_us} us: such early stamps in MulRan's ns would be read as us"
        raise DataError(recording.path, problem, "convert it to another layout")
    if recording.ground_truth is not None:
        write_text(folder / "global_pose.csv", _format_poses(recording.ground_truth))
    images = folder / "sensor_data" / "radar" / form
    images.mkdir(parents=True)
    return images


def _format_poses(truth: Trajectory) -> str:
    """Formats the radar's ground truth as poses of the vehicle, as `_read_poses` reads them."""
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
