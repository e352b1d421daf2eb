"""The sensors beside the radar that a run uses."""

from __future__ import annotations

from dataclasses import dataclass

from mqslam.core.sensors.fixes import Fixes
from mqslam.core.sensors.gyroscope import Gyroscope
from mqslam.core.sensors.mount import Mount


@dataclass(frozen=True, slots=True, eq=False)
class Sensors:
    """What a run knows beside the radar and its odometry; None where there is nothing, or it is not to be used.

    Args:
        gyroscope: readings of a gyroscope.
        fixes: fixes of a GNSS receiver.
        mount: where the radar sits on the vehicle.
    """

    gyroscope: Gyroscope | None = None
    fixes: Fixes | None = None
    mount: Mount | None = None


NO_SENSORS = Sensors()
"""The radar alone."""
