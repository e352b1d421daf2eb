"""Where the radar of Boreas and Boreas-RT sits: the calibrations in `calib/`, seen from the Applanix frame.

Source: github.com/utiasASRL/pyboreas, DATA_REFERENCE.md and issue 44. `T_a_b` takes points of frame b to frame a. The
Applanix frame is x right, y forward, z up; the radar's is x forward, y right, z down.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core.sensors import Mount
from mqslam.errors import DataError, untrusted

TO_FORWARD = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Takes vectors of the Applanix frame to x forward, y left, z up."""
_SQUARE = 1e-3  # the rows of a rotation in a file are of unit length and square to one another within this


@untrusted.reads_file
def read_boreas_mount(calibration: Path) -> Mount | None:
    """Reads the pose of the radar in the Applanix frame, or returns None where the calibrations do not state it.

    Args:
        calibration: the folder `calib`.

    Raises:
        DataError: a file is no transform.
    """
    direct = calibration / "T_applanix_radar.txt"
    to_lidar, from_lidar = calibration / "T_applanix_lidar.txt", calibration / "T_radar_lidar.txt"
    if direct.exists():
        matrix, source = read_transform(direct), str(direct)
    elif to_lidar.exists() and from_lidar.exists():
        matrix = read_transform(to_lidar) @ np.linalg.inv(read_transform(from_lidar))
        source = f"{to_lidar} and {from_lidar.name}"
    else:
        return None
    x, y, _ = TO_FORWARD @ matrix[:3, 3]
    ahead = TO_FORWARD @ matrix[:3, 0]
    return Mount(np.array([x, y, np.arctan2(ahead[1], ahead[0])]), source)


def read_transform(file: Path) -> NDArray[np.float64]:
    """Reads a transform (4, 4) of points.

    Raises:
        DataError: the file holds none.
    """
    try:
        with untrusted.open_text(file) as lines:
            matrix = np.loadtxt(lines, ndmin=2)
        turn = matrix[:3, :3]
        if (
            matrix.shape != (4, 4)
            or not np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0))
            or not np.isfinite(matrix).all()
            or np.abs(turn @ turn.T - np.eye(3)).max() > _SQUARE
        ):
            raise ValueError("its rows are no rotation and translation")
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise DataError(file, f"is no transform of four rows and columns ({reason})", "repair or remove it") from error
    return matrix
