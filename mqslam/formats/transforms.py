"""The pose at which a sensor is mounted, from the transforms of a ROS recording that never change."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.formats.bags import name_frame

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

_USUAL_BODIES = ("base_link", "base_footprint")
_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_STATIC, _MOVING = "tf_static", "tf"
_SAME = 1e-6  # m, and parts of a quaternion: what rounding changes in a transform that is published anew


@dataclass(frozen=True, slots=True)
class LidarMount:
    """A planar lidar on a vehicle.

    Args:
        pose: (3,) x, y [m], yaw [rad] of the lidar in the vehicle's frame.
        upside_down: whether its angles run clockwise seen from above.
    """

    pose: se2.Array
    upside_down: bool


@dataclass(slots=True)
class Mounts:
    """Transforms (4, 4) from a frame to its parent that never change, by frame.

    Args:
        parents: the parent of each frame, with the transform.
        topics: the topic that states the transform of each frame.
        stated: what /tf first stated of each frame: its parent, and numbers x, y, z and quaternion.
        moving: the frames that move by /tf.
    """

    parents: dict[str, tuple[str, NDArray[np.float64]]] = field(default_factory=dict)
    topics: dict[str, str] = field(default_factory=dict)
    stated: dict[str, tuple[str, tuple[float, ...]]] = field(default_factory=dict)
    moving: set[str] = field(default_factory=set)

    @staticmethod
    def reads(connection: Connection) -> bool:
        """Returns whether the messages of a topic are to be added: transforms on /tf_static or /tf, in any namespace."""
        return connection.msgtype in _TYPES and connection.topic.rsplit("/", 1)[-1] in (_STATIC, _MOVING)

    def add(self, message: Any, topic: str = "/tf_static") -> None:
        """Adds the transforms of a `tf2_msgs/TFMessage` on a topic; those on /tf count as long as they never change.

        Raises:
            ValueError: a quaternion on /tf_static is zero.
        """
        is_static = topic.rsplit("/", 1)[-1] == _STATIC
        for stamped in message.transforms:
            move, turn = stamped.transform.translation, stamped.transform.rotation
            frame, parent = name_frame(stamped.child_frame_id), name_frame(stamped.header.frame_id)
            numbers = (move.x, move.y, move.z, turn.x, turn.y, turn.z, turn.w)
            if is_static or (frame not in self.moving and self._stays(frame, parent, numbers) and frame not in self.parents):
                self._place(frame, parent, numbers, topic)

    def _stays(self, frame: str, parent: str, numbers: tuple[float, ...]) -> bool:
        """Returns whether /tf has stated nothing else of a frame; one that moves loses its place."""
        if not np.isfinite(numbers).all() or not any(numbers[3:]):
            return False
        before = self.stated.setdefault(frame, (parent, numbers))
        apart = max(abs(one - other) for one, other in zip(numbers, before[1], strict=True))
        if before[0] == parent and apart <= _SAME:
            return True
        self.moving.add(frame)
        if self.topics.get(frame, "").rsplit("/", 1)[-1] == _MOVING:
            del self.parents[frame], self.topics[frame]
        return False

    def _place(self, frame: str, parent: str, numbers: tuple[float, ...], topic: str) -> None:
        """Keeps a transform."""
        from scipy.spatial.transform import Rotation

        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_quat(numbers[3:]).as_matrix()
        matrix[:3, 3] = numbers[:3]
        self.parents[frame], self.topics[frame] = (parent, matrix), topic

    def find(self, sensor: str, body: str) -> LidarMount | None:
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
        return LidarMount(np.array([matrix[0, 3], matrix[1, 3], yaw]), bool(matrix[2, 2] < 0.0))

    def is_upside_down(self, sensor: str, body: str = "") -> bool:
        """Returns whether a sensor's z axis points down, seen from a body as in `find`, else from the top frame."""
        frame, matrix, passed = name_frame(sensor), np.eye(4), set[str]()
        if (placed := self.place(sensor, body)) is not None:
            return bool(placed[2, 2] < 0.0)
        while frame in self.parents and frame not in passed:
            passed.add(frame)
            frame, step = self.parents[frame]
            with np.errstate(invalid="ignore"):
                matrix = step @ matrix
        return bool(matrix[2, 2] < 0.0)

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
