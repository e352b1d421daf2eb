"""A plane that touches the Earth at a place: metres to the east and to the north of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core.sensors.fixes import Fixes


@dataclass(frozen=True, slots=True)
class TangentPlane:
    """A local tangent plane (WGS 84), east and north of its origin.

    Args:
        latitude, longitude: of its origin [degrees].
    """

    latitude: float
    longitude: float

    @classmethod
    def at_middle(cls, fixes: Fixes) -> TangentPlane:
        """Returns the plane that touches the Earth at the median of fixes, of which there is one at least."""
        return cls(float(np.median(fixes.latitudes)), float(np.median(fixes.longitudes)))

    def project(self, latitudes: NDArray[np.float64], longitudes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns positions (N,) [degrees] in the plane: (N, 2) east, north [m]."""
        from pymap3d import geodetic2enu

        east, north, _ = geodetic2enu(latitudes, longitudes, 0.0, self.latitude, self.longitude, 0.0)
        return np.column_stack([east, north])

    def locate(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns points (N, 2) of the plane [m] on the Earth: (N, 2) latitude, longitude [degrees]."""
        from pymap3d import enu2geodetic

        latitudes, longitudes, _ = enu2geodetic(*points.T, 0.0, self.latitude, self.longitude, 0.0)
        return np.column_stack([latitudes, longitudes])
