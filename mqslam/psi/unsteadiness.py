"""How far the sensor's motion is from what the motion model can follow.

What the model leaves out (potholes, a gear change, a jittering truth) shows in how relative motions jump from scan to scan
beyond what their covariance explains. Third differences of the poses are used: steady speed, acceleration and turning drop
out of them. A model that cannot follow a jump errs by as much as the jump.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mqslam.config import TrackerConfig
from mqslam.core.measurement import Measurement, Status
from mqslam.core.statistics.gross import MEDIAN_OF_CHI2
from mqslam.psi.tracking.dynamics import SIGMA_AX, SIGMA_VY

# Number of scans around one that show how far its motion is from what the motion model can follow.
_UNSTEADY_SCANS = 40
# With fewer such scans, the process noise stands in for part of what the motion model leaves out.
_UNSTEADY_LEAST = 8

_GAIN = 10.0  # variance of a third difference of poses over that of a first one, for poses that err independently: 20 / 2


def estimate_unsteadiness(
    motions: Sequence[Measurement], settings: TrackerConfig, revolution_s: float
) -> NDArray[np.float64]:
    """Estimates the variance (N, 3) of x [m^2], y [m^2], yaw [rad^2] that the motion model leaves out of each motion.

    It is zero for a motion that was lost, which is more unsure than that already.

    Args:
        motions: N successive ones.
        settings: how many of them show it, and the process noise. That stands in where there are too few: an acceleration
            that changes as much as it can within a scan.
        revolution_s: duration of a turn [s].
    """
    left_out = np.zeros((len(motions), 3))
    followed = [k for k, motion in enumerate(motions) if motion.status is not Status.LOST]
    change = [0.5 * SIGMA_AX * revolution_s, SIGMA_VY, 0.5 * settings.sigma_alpha * revolution_s]
    unknown = np.square(change) * revolution_s**2
    if len(followed) < 3:
        left_out[followed] = unknown
        return left_out
    row = np.dtype((np.float64, 3))
    poses = np.asarray(np.fromiter((motions[k].pose for k in followed), row), dtype=np.float64)
    squares = np.diff(poses, n=2, axis=0) ** 2 / _GAIN
    diagonals = (np.diag(motions[k].covariance) for k in followed)
    expected = np.asarray(np.fromiter(diagonals, row), dtype=np.float64)
    half = _UNSTEADY_SCANS // 2
    for n, k in enumerate(followed):
        jumps = squares[max(n - half - 1, 0) : n + half]  # a jump compares three motions, of which this one is the second
        known = min(1.0, len(jumps) / _UNSTEADY_LEAST)
        near = expected[max(n - half, 0) : n + half + 1]
        beyond = np.median(jumps, axis=0) / MEDIAN_OF_CHI2 - np.median(near, axis=0)
        left_out[k] = (1.0 - known) * unknown + known * np.maximum(beyond, 0.0)
    return left_out
