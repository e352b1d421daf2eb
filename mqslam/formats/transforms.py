"""Reads the transforms between the frames of a ROS recording: static transforms, and those that change over time."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.formats.bags import TF_TYPE, Clock, describe_left_out, name_frame
from mqslam.formats.poses import mark_places

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

_BODIES = ("base_link", "base_footprint")
_TYPES = (TF_TYPE, "tf/msg/tfMessage")
_STATIC, _MOVING = "tf_static", "tf"
_LISTED = 12
_SAME = 1e-6  # transforms whose numbers (m, or components of a quaternion) differ by less count as the same
_Numbers = tuple[float, ...]  # x, y, z [m] and the quaternion x, y, z, w


def holds_transforms(connection: Connection) -> bool:
    """Returns whether the messages on a topic are transforms."""
    return connection.msgtype in _TYPES


def is_static(topic: str) -> bool:
    """Returns whether a topic is /tf_static in any namespace: the transforms on it never change."""
    return topic.rsplit("/", 1)[-1] == _STATIC


def _list_links(message: Any) -> Iterator[tuple[Any, str, str, _Numbers]]:
    """Yields each TransformStamped of a `tf2_msgs/TFMessage`, with the names of its frame and parent and its `_Numbers`."""
    for stamped in message.transforms:
        move, turn = stamped.transform.translation, stamped.transform.rotation
        numbers = (move.x, move.y, move.z, turn.x, turn.y, turn.z, turn.w)
        yield stamped, name_frame(stamped.child_frame_id), name_frame(stamped.header.frame_id), numbers


def _is_motion(numbers: _Numbers) -> bool:
    """Returns whether a transform has finite numbers, coordinates of at most 1e9 m, and a quaternion that is not zero."""
    is_finite = np.isfinite(numbers).all() and mark_places(np.array(numbers[:3]))
    return bool(is_finite and np.linalg.norm(numbers[3:]) > 0.0)


@dataclass(slots=True)
class Mounts:
    """The transforms of a recording that never change; each converts points [m] from a frame to its parent.

    Args:
        parents: by frame, the name of its parent, the numbers of the transform (x, y, z [m] and the quaternion x, y, z, w),
            and the topic that states it. Frames in `moving` are left out.
        moving: the frames whose transforms on /tf have changed; later transforms of these frames on /tf are ignored.
    """

    parents: dict[str, tuple[str, _Numbers, str]] = field(default_factory=dict)
    moving: set[str] = field(default_factory=set)

    @staticmethod
    def reads(connection: Connection) -> bool:
        """Returns whether `add` takes the messages of a topic: transforms on /tf_static or /tf, in any namespace."""
        return holds_transforms(connection) and connection.topic.rsplit("/", 1)[-1] in (_STATIC, _MOVING)

    def add(self, message: Any, topic: str) -> None:
        """Adds the transforms of a `tf2_msgs/TFMessage` on a topic.

        A transform on /tf_static replaces what is known of its frame. A transform on /tf is used only for a frame of which
        nothing is known yet, and it is removed when a later message on /tf states another one for the frame.

        Raises:
            ValueError: a quaternion on /tf_static is zero.
        """
        for _, frame, parent, numbers in _list_links(message):
            if is_static(topic):
                if np.linalg.norm(numbers[3:]) == 0.0:
                    raise ValueError("holds a quaternion of zeros")
                self.parents[frame] = parent, numbers, topic
            elif frame not in self.moving and _is_motion(numbers):
                known_parent, known, source = self.parents.setdefault(frame, (parent, numbers, topic))
                apart = max(abs(one - other) for one, other in zip(numbers, known, strict=True))
                if not is_static(source) and (known_parent != parent or apart > _SAME):
                    self.moving.add(frame)
                    del self.parents[frame]

    def find_topic(self, frame: str) -> str:
        """Returns the topic that states where a frame lies in its parent; "" if no topic states it."""
        return self.parents[name_frame(frame)][2] if name_frame(frame) in self.parents else ""

    def place(self, sensor: str, body: str = "") -> NDArray[np.float64] | None:
        """Finds the transform (4, 4) of points [m] from a sensor's frame to a body's frame.

        Args:
            sensor: frame of the sensor.
            body: frame of the body; "" takes base_link or base_footprint, whichever is nearer above the sensor.

        Returns:
            The transform, or None if no transforms connect the frames.
        """
        bodies = (name_frame(body),) if body else _BODIES
        frame, matrix = self._climb(sensor, bodies)
        return matrix if frame in bodies else None

    def find(self, sensor: str, body: str = "") -> se2.Array | None:
        """Returns the pose (3,) x, y [m], yaw [rad] of a sensor in a body's frame; None if no transforms connect the frames.

        `sensor` and `body` are names of frames; a body of "" is chosen as `place` chooses it.
        """
        matrix = self.place(sensor, body)
        if matrix is None:
            return None
        return np.array([matrix[0, 3], matrix[1, 3], np.arctan2(matrix[1, 0], matrix[0, 0])])

    def is_upside_down(self, sensor: str, body: str = "") -> bool:
        """Returns whether a sensor's z axis points down in a body's frame; `place` says which frame a body of "" means.

        If no transforms connect the frames, the topmost frame above the sensor takes the body's place.
        """
        return bool(self._climb(sensor, (name_frame(body),) if body else _BODIES)[1][2, 2] < 0.0)

    def _climb(self, sensor: str, bodies: Collection[str]) -> tuple[str, NDArray[np.float64]]:
        """Returns the nearest of `bodies` above a sensor, or else the topmost frame, with the transform (4, 4) [m] to it."""
        from scipy.spatial.transform import Rotation

        frame, matrix, passed = name_frame(sensor), np.eye(4), set[str]()
        while frame not in bodies and frame in self.parents and frame not in passed:
            passed.add(frame)
            frame, numbers, _ = self.parents[frame]
            step = np.eye(4)
            step[:3, :3], step[:3, 3] = Rotation.from_quat(numbers[3:]).as_matrix(), numbers[:3]
            with np.errstate(invalid="ignore"):  # a transform that is not finite shows in the result
                matrix = step @ matrix
        return frame, matrix


@dataclass(slots=True)
class _Link:
    """The transforms of a frame over time.

    Args:
        parents: the parents that messages name; a second parent is a contradiction.
        rows: by stamp [us], the transform to the parent: x, y, z [m] and the quaternion x, y, z, w.
    """

    parents: list[str]
    rows: dict[int, _Numbers] = field(default_factory=dict)

    @property
    def moves(self) -> bool:
        """Whether the transform ever changes."""
        return len(set(self.rows.values())) > 1


@dataclass(slots=True)
class Transforms:
    """The transforms between frames over time.

    Args:
        links: by child frame, its transforms to its parent frame.
        left_out: number of transforms that were left out because a number is not finite, the place is over 1e9 m away, or
            the quaternion is zero.
        clock: reads the stamps of the transforms.
    """

    links: dict[str, _Link] = field(default_factory=dict)
    left_out: int = 0
    clock: Clock = field(default_factory=Clock)

    def add(self, message: Any, topic: str, logged_ns: int) -> None:
        """Adds the transforms of a `tf2_msgs/TFMessage`; invalid transforms are left out and counted.

        Args:
            message: the message with the transforms.
            topic: topic of the message.
            logged_ns: when the message was recorded [ns], which is the time of transforms without stamps.
        """
        for stamped, frame, parent, numbers in _list_links(message):
            if not _is_motion(numbers):
                self.left_out += 1
                continue
            link = self.links.setdefault(frame, _Link([parent]))
            if parent not in link.parents:
                link.parents.append(parent)
            link.rows[self.clock.stamp(topic, stamped, logged_ns)] = numbers

    @property
    def notes(self) -> list[str]:
        """Notes for the user on transforms without stamps, one per topic except static topics, and on invalid transforms."""
        unstamped = {name: n for name, n in self.clock.unstamped.items() if not name.endswith("static")}
        left_out = describe_left_out(self.left_out, count_of(self.left_out, "transform"))
        return Clock(self.clock.read, unstamped).notes + left_out

    def choose(self, frame: str | None) -> str:
        """Chooses the frame whose trajectory is read.

        Args:
            frame: name of a frame that moves; None takes, in this order and in any namespace, (1) base_link, (2)
                base_footprint, (3) the only frame that moves in its parent and below which no frame moves in its parent.

        Raises:
            ValueError: the named frame does not move; or, for None, no frame moves, or several frames fit alike.
        """
        own = {name for name, link in self.links.items() if link.moves}
        moving = sorted(name for name in self.links if not own.isdisjoint(self._climb(name)))
        listed = f"frames that move: {', '.join(moving[:_LISTED]) or 'none'}"
        if frame is not None:
            if name_frame(frame) not in moving:
                raise ValueError(f"has no transforms by which the frame {frame} moves ({listed})")
            return name_frame(frame)
        for body in _BODIES:
            if bodies := [name for name in moving if name.rsplit("/", 1)[-1] == body]:
                break
        else:
            bodies = sorted(own - {link for name in own for link in self._climb(name)[1:]})
        if len(bodies) != 1:
            several = f"has transforms of {len(bodies)} frames that may be the vehicle's"
            raise ValueError(f"{several if bodies else 'has no transforms by which the vehicle moves'} ({listed})")
        return bodies[0]

    def trace(self, frame: str) -> Trajectory:
        """Returns the poses of a frame in the root, the topmost frame above it.

        Of the transforms between the frame and the root, the one with most stamps gives the poses their stamps. The others
        are interpolated there, as tf2 does. Stamps outside the time span of a transform that changes give no pose.

        Raises:
            ValueError: the frame or one above it has two parents, the frames form a ring, or fewer than two poses result.
        """
        from scipy.spatial.transform import Rotation

        chain = self._climb(frame)
        for name in chain:
            if len(self.links[name].parents) > 1:
                raise ValueError(f"states several parents of the frame {name} ({', '.join(self.links[name].parents)})")
        if self.links[chain[-1]].parents[0] in chain:
            raise ValueError(f"places the frames {', '.join(chain)} in a ring")
        moving = [sorted(self.links[name].rows) for name in chain if self.links[name].moves]
        first, last = max(stamps[0] for stamps in moving), min(stamps[-1] for stamps in moving)
        stamps = np.array([s for s in max(moving, key=len) if first <= s <= last], dtype=np.int64)
        if len(stamps) < 2:
            raise ValueError(f"holds fewer than two times at which all of {', '.join(chain)} have a transform")
        places, turn = np.zeros((len(stamps), 3)), Rotation.identity(len(stamps))
        for name in chain:
            move, step = self._interpolate(name, stamps)
            places, turn = step.apply(places) + move, step * turn
        ahead = turn.as_matrix()[:, :, 0]
        return Trajectory(stamps, np.column_stack([places[:, :2], np.arctan2(ahead[:, 1], ahead[:, 0])]))

    def _climb(self, frame: str) -> list[str]:
        """Returns a frame and the frames above it, without the root; if the frames form a ring, each of them once."""
        chain: list[str] = []
        while frame in self.links and frame not in chain:
            chain.append(frame)
            frame = self.links[frame].parents[0]
        return chain

    def _interpolate(self, frame: str, stamps: NDArray[np.int64]) -> tuple[NDArray[np.float64], Any]:
        """Interpolates the translations [m] and N rotations of a frame at stamps (N,) [us] within its time span.

        The translations are (N, 3), or a single translation (3,) if the frame never moves.
        """
        from scipy.spatial.transform import Rotation, Slerp

        link = self.links[frame]
        if not link.moves:
            row = np.array(next(iter(link.rows.values())))
            return row[:3], Rotation.from_quat(np.tile(row[3:], (len(stamps), 1)))
        known = sorted(link.rows)
        rows = np.array([link.rows[stamp] for stamp in known])
        since, wanted = (np.asarray(t, dtype=np.int64) - known[0] for t in (known, stamps))
        moves = np.column_stack([np.interp(wanted, since, rows[:, axis]) for axis in range(3)])
        return moves, Slerp(since.astype(np.float64), Rotation.from_quat(rows[:, 3:]))(wanted.astype(np.float64))
