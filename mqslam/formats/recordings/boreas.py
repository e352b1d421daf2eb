"""The layouts Boreas and Boreas-RT: `radar/<t>.png` of Oxford rows, with `calib/` or `applanix/` beside it.

Source: github.com/utiasASRL/pyboreas, DATA_REFERENCE.md, DATA_RT_REFERENCE.md, pyboreas/utils. An image and its pose are
stamped in the middle of the revolution (row floor(A / 2) - 1).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mqslam.core.trajectory import Trajectory
from mqslam.formats.odometry_files import read_beside, read_stamped
from mqslam.formats.recordings import oxford
from mqslam.formats.shared.images import stamped_names
from mqslam.formats.shared.poses import checked
from mqslam.formats.shared.row_images import RowImageRecording, index_rows
from mqslam.formats.shared.sensing import Sensing

UPGRADE_US = 1_632_182_400_000_000
"""2021-09-21, when another radar was mounted."""
RANGE_RESOLUTION_BEFORE_M = 0.0596
RANGE_RESOLUTION_M = 0.04381


def recognises(path: Path) -> bool:
    """Whether the path is a recording of Oxford's names with a folder `calib` or `applanix` beside the images."""
    root = oxford.image_folder(path).parent
    return oxford.recognises(path) and any((root / name).is_dir() for name in ("calib", "applanix"))


def open_recording(path: Path, sensing: Sensing) -> RowImageRecording:
    """Index a recording of Boreas: names, two images and the poses are read, whatever its length.

    Raises:
        DataError: no revolutions, or a file that cannot be used.
    """
    folder = oxford.image_folder(path)
    images = index_rows(folder, stamped_names(folder))
    poses = folder.parent / "applanix" / "radar_poses.csv"
    truth, faults = read_beside(lambda: _read_poses(poses) if poses.exists() else None)
    return images.recording(
        path,
        "boreas",
        sensing.range_resolution or usual_resolution(int(images.stamps_us[0])),
        ground_truth=truth,
        notes=sensing.idle(),
        faults=faults,
    )


def usual_resolution(start_us: int) -> float:
    """Length of a range bin [m] of the radar that was mounted at a stamp [us]."""
    return RANGE_RESOLUTION_BEFORE_M if start_us < UPGRADE_US else RANGE_RESOLUTION_M


def _read_poses(file: Path) -> Trajectory:
    """The poses of the radar, x forward, y right, z down, in a frame of east, north and up, as planar REP 103.

    Columns: stamp, easting, northing, altitude [m], three velocities, roll, pitch, heading [rad], three rates; and
    C_enu_radar = R1(roll) R2(pitch) R3(heading), where R turn the axes, not the vectors. Roll is near pi, so the heading
    goes counter-clockwise from east as yaw does; exactly, the yaw is where the radar's x axis points.
    """
    stamps, table = read_stamped(file, [1, 2, 7, 8, 9])
    easting, northing, roll, pitch, heading = table.T
    east = np.cos(pitch) * np.cos(heading)
    north = np.sin(roll) * np.sin(pitch) * np.cos(heading) - np.cos(roll) * np.sin(heading)
    return checked(file, stamps, np.column_stack([easting, northing, np.arctan2(north, east)]))
