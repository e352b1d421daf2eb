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

    def carry(self, frame: se2.Array) -> Georeference:
        """Returns where a map lies whose frame is another one, in which the frame of the present one has a pose (3,)."""
        return Georeference(self.plane, se2.compose(self.pose, se2.inverse(frame)))

    def locate(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns points (N, 2) of the map [m] on the Earth: (N, 2) latitude, longitude [degrees]."""
        return self.plane.locate(se2.transform(self.pose, points))
