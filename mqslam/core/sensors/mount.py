"""Where a sensor sits on the vehicle."""

from __future__ import annotations

from dataclasses import dataclass

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory

RADAR, VEHICLE = "radar", "vehicle"
"""What the poses that a run writes may be the poses of."""


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """The planar pose of the radar on the vehicle, x forward, y left (REP 103).

    Args:
        pose: (3,) x [m], y [m] and yaw [rad] of the radar in the vehicle's frame.
        source: the file, topic or publication that states it, for messages.
        given: whether the user states it, and not the recording.
    """

    pose: se2.Array
    source: str
    given: bool = False

    def carry_to_radar(self, vehicle: Trajectory) -> Trajectory:
        """Returns the poses of the radar on a vehicle, in the frame in which the vehicle's poses are given."""
        return Trajectory(vehicle.stamps_us, se2.compose(vehicle.poses, self.pose))

    def carry_to_vehicle(self, radar: Trajectory) -> Trajectory:
        """Returns the poses of the vehicle under a radar, in the frame in which the radar's poses are given."""
        return Trajectory(radar.stamps_us, se2.compose(radar.poses, se2.inverse(self.pose)))
