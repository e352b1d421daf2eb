"""The layout MulRan: polar images under `sensor_data/radar/`, in one of two forms or both.

`polar/<t>.png` has one column per azimuth and no metadata; `polar_oxford_form/<t>.png` has Oxford rows, with stamps in ns
like the names. An image is stamped at the end of its revolution.

Source: sites.google.com/view/mulran-pr; github.com/url-kaist/outlier-robust-radar-odometry (ORORA), which states the stamp
and the calibration.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mqslam.core import se2
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.odometry_files import read_beside, read_stamped
from mqslam.formats.shared.azimuth_rows import in_us
from mqslam.formats.shared.column_images import column_recording
from mqslam.formats.shared.images import stamped_names
from mqslam.formats.shared.poses import checked
from mqslam.formats.shared.row_images import index_rows
from mqslam.formats.shared.sensing import Sensing

RANGE_RESOLUTION_M = 0.0595
ROWS, COLUMNS = "polar_oxford_form", "polar"
BASE_TO_RADAR = (1.50, -0.04, float(np.deg2rad(0.9)))
"""Pose of the radar on the vehicle [m, m, rad]: calib_base2radar.txt of the dataset, of which z is left out."""


def recognises(path: Path) -> bool:
    """Whether the path holds images in one of the two forms, or is the folder of one."""
    return any(_folders(path))


def open_recording(path: Path, sensing: Sensing) -> Recording:
    """Index a recording of MulRan: names, two images and the poses are read, whatever its length.

    Rows with own stamps go before columns without.

    Raises:
        DataError: no revolutions, or a file that cannot be used.
    """
    folder = next(_folders(path), None)
    if folder is None:
        remedy = f"give the folder that holds sensor_data/radar/{COLUMNS} or {ROWS}"
        raise DataError(path, "holds no radar images of MulRan", remedy)
    poses = next((file for above in folder.resolve().parents[:3] if (file := above / "global_pose.csv").exists()), None)
    truth, faults = read_beside(lambda: _read_poses(poses) if poses else None)
    names = stamped_names(folder)
    if folder.resolve().name == ROWS:
        resolution, notes = sensing.range_resolution or RANGE_RESOLUTION_M, sensing.idle()
        images = index_rows(folder, names)
        return images.recording(path, "mulran", resolution, ground_truth=truth, notes=notes, faults=faults)
    resolution = RANGE_RESOLUTION_M
    return column_recording(
        path, "mulran", folder, names, in_us(names), resolution, sensing, ground_truth=truth, faults=faults
    )


def _folders(path: Path) -> Iterator[Path]:
    """Folders of images in and above which the path may be, the ones with own stamps first."""
    for form in (ROWS, COLUMNS):
        inside = (path / "sensor_data" / "radar" / form, path / "radar" / form, path / form)
        for folder in (*inside, path) if path.resolve().name == form else inside:
            if any(image.stem.isdecimal() for image in folder.glob("*.png")):
                yield folder


def _read_poses(file: Path) -> Trajectory:
    """The poses of the vehicle, carried to the radar: stamp [ns] and a 3 x 4 matrix by rows, already REP 103."""
    stamps, table = read_stamped(file, [1, 4, 5, 8])
    cosine, x, sine, y = table.T
    vehicle = np.column_stack([x, y, np.arctan2(sine, cosine)])
    return checked(file, stamps, se2.compose(vehicle, BASE_TO_RADAR))
