"""Odometry as the leaderboard of Boreas takes it: a line per image with its stamp and the pose of the world in the radar.

Source: github.com/utiasASRL/pyboreas, `pyboreas/utils/odometry.py`. The radar's frame is x forward, y right, z down.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core.trajectory import Trajectory
from mqslam.execution.files import write_text


def write_boreas_odometry(path: Path, trajectory: Trajectory, stamps_us: NDArray[np.int64]) -> None:
    """Writes a trajectory at the stamps of a sequence's images, with which the leaderboard compares it line by line.

    Args:
        path: the file, which the leaderboard wants to be named after the sequence.
        trajectory: of the radar.
        stamps_us: (N,) of the images [us], which lie in the middles of the turns.

    Raises:
        OutputError: the file cannot be written.
    """
    lines = []
    for stamp, (x, y, yaw) in zip(stamps_us.tolist(), trajectory.at(stamps_us).tolist(), strict=True):
        c, s = np.cos(yaw), np.sin(yaw)
        turn = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])  # columns: forward, right and down in the world
        matrix = np.column_stack([turn.T, -turn.T @ [x, y, 0.0]])
        lines.append(" ".join([str(stamp), *(f"{number:.12g}" for number in matrix.reshape(-1))]))
    write_text(path, "\n".join(lines) + "\n")
