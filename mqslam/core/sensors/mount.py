"""Where a sensor sits on the vehicle."""

from __future__ import annotations

from dataclasses import dataclass

from mqslam.core import se2


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """The planar pose of the radar on the vehicle, x forward, y left (REP 103).

    Args:
        pose: (3,) x [m], y [m] and yaw [rad] of the radar in the vehicle's frame.
        source: the file, topic or publication that states it, for messages.
    """

    pose: se2.Array
    source: str
