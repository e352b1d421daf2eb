"""A radar that is mounted on a vehicle whose wheels report another point's motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.simulator import (
    Drive,
)


@dataclass(frozen=True)
class MountedDrive(Drive):
    """The motion of a sensor on a vehicle.

    Args:
        vehicle: its motion.
        mount: (3,) pose of the sensor on it [m, m, rad].
    """

    vehicle: Drive
    mount: se2.Array

    def poses(self, times: NDArray[np.float64]) -> se2.Array:
        return se2.compose(self.vehicle.poses(times), self.mount)

    def twists(self, times: NDArray[np.float64]) -> se2.Array:
        return self.vehicle.twists(times) @ se2.adjoint(se2.inverse(self.mount)).T
