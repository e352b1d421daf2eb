"""Where a map lies on the Earth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.sensors.tangent_plane import TangentPlane


@dataclass(frozen=True, slots=True, eq=False)
class Georeference:
    """The pose of a map in a local tangent plane.

    Args:
        plane: the tangent plane.
        pose: (3,) of the map's frame in it: east [m], north [m], and yaw counter-clockwise from east [rad].
    """

    plane: TangentPlane
    pose: se2.Array

    def locate(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns points (N, 2) of the map [m] on the Earth: (N, 2) latitude, longitude [degrees]."""
        return self.plane.locate(se2.transform(self.pose, points))
