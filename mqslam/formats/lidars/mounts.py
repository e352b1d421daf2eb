"""The pose at which a sensor is mounted, from the static transforms of a ROS recording."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.formats.shared.bags import name_frame

_USUAL_BODIES = ("base_link", "base_footprint")


@dataclass(frozen=True, slots=True)
class Mount:
    """A planar lidar on a vehicle.

    Args:
        pose: (3,) x, y [m], yaw [rad] of the lidar in the vehicle's frame.
        upside_down: whether its angles run clockwise seen from above.
    """

    pose: se2.Array
    upside_down: bool


@dataclass(slots=True)
class Mounts:
    """Static transforms (4, 4) from a frame to its parent, by frame."""

    parents: dict[str, tuple[str, NDArray[np.float64]]] = field(default_factory=dict)

    def add(self, message: Any) -> None:
        """Adds the transforms of a `tf2_msgs/TFMessage`."""
        from scipy.spatial.transform import Rotation

        for stamped in message.transforms:
            move, turn = stamped.transform.translation, stamped.transform.rotation
            matrix = np.eye(4)
            matrix[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
            matrix[:3, 3] = move.x, move.y, move.z
            self.parents[name_frame(stamped.child_frame_id)] = (name_frame(stamped.header.frame_id), matrix)

    def find(self, sensor: str, body: str) -> Mount | None:
        """Finds how a sensor is mounted.

        Args:
            sensor: its frame.
            body: the vehicle's frame, "" for the usual ones.

        Returns:
            The mount, or None where no transforms connect the frames.
        """
        matrix = self.place(sensor, body)
        if matrix is None:
            return None
        yaw = np.arctan2(matrix[1, 0], matrix[0, 0])
        return Mount(np.array([matrix[0, 3], matrix[1, 3], yaw]), bool(matrix[2, 2] < 0.0))

    def place(self, sensor: str, body: str) -> NDArray[np.float64] | None:
        """Returns the transform (4, 4) of points of a sensor's frame into the vehicle's, or None as `find` does."""
        bodies = (name_frame(body),) if body else _USUAL_BODIES
        frame, matrix, passed = name_frame(sensor), np.eye(4), set[str]()
        while frame not in bodies:
            passed.add(frame)
            if frame not in self.parents or self.parents[frame][0] in passed:
                return None
            frame, step = self.parents[frame]
            with np.errstate(invalid="ignore"):  # a transform that is not finite shows in the result
                matrix = step @ matrix
        return matrix
