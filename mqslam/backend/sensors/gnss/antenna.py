"""Where the antenna of a GNSS receiver sits, seen from the radar, estimated from the fixes of a drive that turns.

In a turn the antenna swings about the radar. What it swings by shows in the differences of successive fixes, held against
the motions between them: the errors that wander with the satellites hardly change from one fix to the next. How the map
lies, a steady drift of its heading, its scale and a receiver's clock that is late move the fixes, too, and are estimated
along. A clock that is late looks like an antenna farther behind as long as the speed stays the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.sensors.gnss.fix_noise import FixNoise
from mqslam.backend.sensors.odometry.odometry_calibration import DELAY_S, MOUNT_M, Design, fit
from mqslam.core import se2
from mqslam.factors.gnss_position import REACH

_ROUNDS: Final = 5  # of fit and choice of the differences that are no jumps, which settle in fewer
_TURNED_RAD: Final = 1.0  # numerical: the map lies on the fixes already, so that it is turned by far less
_SCALED: Final = 0.1  # numerical: no trajectory is off in its scale by as much


@dataclass(frozen=True, slots=True)
class Antenna:
    """Where an antenna sits, as its fixes say.

    Args:
        place: (2,) in the radar's frame, forward and left [m].
        covariance: (2, 2) of it [m^2].
    """

    place: NDArray[np.float64]
    covariance: NDArray[np.float64]

    @property
    def sigmas(self) -> NDArray[np.float64]:
        """Standard deviations (2,) forward and left [m]."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def significance(self) -> float:
        """How far the place is from the radar's own, in standard deviations."""
        return float(np.sqrt(self.place @ np.linalg.solve(self.covariance, self.place)))


def estimate_antenna(
    times: NDArray[np.float64], sensor: se2.Array, positions: NDArray[np.float64], noise: FixNoise
) -> Antenna:
    """Estimates where an antenna sits.

    Args:
        times: (F,) of the fixes [s], increasing, of which there are three or more.
        sensor: (F, 3) poses of the radar then, in the tangent plane [m, m, rad].
        positions: (F, 2) that were fixed, in the tangent plane [m].
        noise: of the fixes.
    """
    lasts = np.diff(times)
    moved, seen = np.diff(sensor[:, :2], axis=0), np.diff(positions, axis=0)
    c, s = np.diff(np.cos(sensor[:, 2])), np.diff(np.sin(sensor[:, 2]))
    ahead, left = np.column_stack([c, s]), np.column_stack([-s, c])
    aside = np.column_stack([-moved[:, 1], moved[:, 0]])
    middle = (0.5 * (times[1:] + times[:-1]) - times.mean()) / max(float(np.ptp(times)), 1e-9)
    velocities = np.gradient(sensor[:, :2], times, axis=0)
    columns = [ahead, left, aside, aside * middle[:, None], moved, -np.diff(velocities, axis=0)]
    jacobians = np.zeros((len(lasts), 3, len(columns)))
    jacobians[:, :2] = np.stack(columns, axis=-1)
    design = Design(jacobians, np.tile(np.arange(len(columns)), (len(lasts), 1)), np.empty(0))
    prior = np.diag(1.0 / np.square([MOUNT_M, MOUNT_M, _TURNED_RAD, _TURNED_RAD, _SCALED, DELAY_S]))
    measured = np.full((len(lasts), 3), 2.0 * noise.white_m**2)
    walked = np.repeat(noise.walk_m**2 * lasts[:, None], 3, axis=1)
    limits = REACH * np.sqrt(measured[:, :2] + walked[:, :2])
    misses = np.column_stack([seen - moved, np.zeros(len(lasts))])
    parameters = np.zeros(len(columns))
    for _ in range(_ROUNDS):
        residuals = (misses - jacobians @ parameters)[:, :2]
        jumps = np.any(np.abs(residuals) > limits, axis=1)
        found = fit(design, np.where(jumps[:, None], np.nan, misses), measured, walked, prior)
        parameters = found.parameters
    return Antenna(parameters[:2], found.covariance[:2, :2])
