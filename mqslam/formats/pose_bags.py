"""Trajectories in ROS bags: a topic of poses, or the transforms between frames."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.errors import DataError
from mqslam.formats import bags
from mqslam.formats.bags import Clock, describe_left_out, name_frame

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

_BODIES = ("base_link", "base_footprint")
_LISTED = 12
_POSE_TYPES = (bags.ODOMETRY_TYPE, bags.POSE_TYPE, bags.POSE_WITH_COVARIANCE_TYPE, bags.PATH_TYPE)
_TRANSFORM_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_STATIC = "tf_static"
_AT_ONCE_US = 10_000  # nothing drives in so short a time: whoever wrote the bag did so afterwards


@dataclass(slots=True)
class _Link:
    """The transforms from one frame to another.

    Args:
        parents: the frames that it was stated in; more than one is a contradiction.
        rows: x, y, z [m] and the quaternion x, y, z, w by stamp [us].
    """

    parents: list[str]
    rows: dict[int, tuple[float, ...]] = field(default_factory=dict)

    @property
    def moves(self) -> bool:
        """Whether it ever changes."""
        return len(set(self.rows.values())) > 1


@dataclass(slots=True)
class Transforms:
    """Transforms between frames over time, by the frame that they place.

    Args:
        links: them.
        left_out: number of those that hold a quaternion of zeros, or a number that is not finite.
        clock: reads their stamps.
    """

    links: dict[str, _Link] = field(default_factory=dict)
    left_out: int = 0
    clock: Clock = field(default_factory=Clock)

    def add(self, message: Any, topic: str, logged_ns: int) -> None:
        """Adds the transforms of a `tf2_msgs/TFMessage`; those that are no motion are left out, and counted.

        Args:
            message: with the transforms.
            topic: that it is on.
            logged_ns: when it was recorded [ns], which is the time of transforms without stamps.
        """
        for stamped in message.transforms:
            move, turn = stamped.transform.translation, stamped.transform.rotation
            row = (move.x, move.y, move.z, turn.x, turn.y, turn.z, turn.w)
            if not np.isfinite(row).all() or not any(row[3:]):
                self.left_out += 1
                continue
            parent = name_frame(stamped.header.frame_id)
            link = self.links.setdefault(name_frame(stamped.child_frame_id), _Link([parent]))
            if parent not in link.parents:
                link.parents.append(parent)
            link.rows[self.clock.stamp(topic, stamped, logged_ns)] = row

    @property
    def notes(self) -> list[str]:
        """What to tell of transforms without stamps, and of those that were left out: a line for each, or none."""
        unstamped = Clock(
            self.clock.read, {name: n for name, n in self.clock.unstamped.items() if not name.endswith("static")}
        )
        return unstamped.notes + describe_left_out(self.left_out, count_of(self.left_out, "transform"))

    def choose(self, frame: str | None) -> str:
        """Chooses the frame whose path is wanted.

        Args:
            frame: its name; None takes a vehicle's usual frame, or the only one that moves and carries no other that does.

        Raises:
            ValueError: no such frame moves, or several do.
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
            raise ValueError(f"has transforms of {len(bodies)} frames that may be the vehicle's ({listed})")
        return bodies[0]

    def trace(self, frame: str) -> Trajectory:
        """Returns the poses of a frame in the root of its tree, at the stamps of the most frequent transform between them.

        The others are interpolated in between, as tf2 does; where one of them is missing, there are no poses.

        Raises:
            ValueError: a frame between them has two parents, there is no root, or the transforms share no two stamps.
        """
        from scipy.spatial.transform import Rotation

        chain = self._climb(frame)
        for name in chain:
            if len(self.links[name].parents) > 1:
                raise ValueError(f"places the frame {name} in several others ({', '.join(self.links[name].parents)})")
        if self.links[chain[-1]].parents[0] in chain:
            raise ValueError(f"places the frames {', '.join(chain)} in a ring")
        moving = [sorted(self.links[name].rows) for name in chain if self.links[name].moves]
        first, last = max(stamps[0] for stamps in moving), min(stamps[-1] for stamps in moving)
        stamps = np.array([s for s in max(moving, key=len) if first <= s <= last], dtype=np.int64)
        if len(stamps) < 2:
            raise ValueError(f"has no two transforms of all of {', '.join(chain)} at the same time")
        places, turn = np.zeros((len(stamps), 3)), Rotation.identity(len(stamps))
        for name in chain:
            move, step = self._interpolate(name, stamps)
            places, turn = step.apply(places) + move, step * turn
        ahead = turn.as_matrix()[:, :, 0]
        poses: se2.Array = np.column_stack([places[:, :2], np.arctan2(ahead[:, 1], ahead[:, 0])])
        return Trajectory(stamps, poses)

    def _climb(self, frame: str) -> list[str]:
        """Returns a frame and those that it is placed in, up to the last below the root, or once around a ring."""
        chain: list[str] = []
        while frame in self.links and frame not in chain:
            chain.append(frame)
            frame = self.links[frame].parents[0]
        return chain

    def _interpolate(self, frame: str, stamps: NDArray[np.int64]) -> tuple[NDArray[np.float64], Any]:
        """Interpolates the moves (N, 3) [m] and the rotations (N) of a transform at stamps (N,) [us] within its own."""
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


def read_bag(path: Path, topic: str | None, frame: str | None) -> tuple[Trajectory, list[str]]:
    """Reads the trajectory in a bag, and what a user should know about how it was understood.

    Args:
        path: the bag.
        topic: a topic of poses or of transforms; None takes the only one of poses, or all transforms where there is none.
        frame: a frame whose pose the transforms give; None takes a vehicle's usual one, or the only one that moves.

    Raises:
        DataError: there is no such trajectory, or several.
    """
    with bags.open_bag(path) as reader:
        filled = [c for c in reader.connections if c.msgcount]
        poses = sorted({c.topic for c in filled if c.msgtype in _POSE_TYPES})
        transforms = [c for c in filled if c.msgtype in _TRANSFORM_TYPES]
        moving = sorted({c.topic for c in transforms if not _is_static(c)})
        if topic in moving or (topic is None and moving and (frame is not None or not poses)):
            read = [c for c in transforms if topic in (None, c.topic) or _is_static(c)]
            return _read_transforms(path, reader, read, frame)
        if frame is not None:
            problem = f"has no transforms on {topic}" if topic else "has no transforms"
            raise DataError(path, f"{problem} (topics: {bags.list_topics(reader)})", "leave the frame out")
        chosen = [name for name in poses if topic in (None, name)]
        if len(chosen) != 1:
            problem = f"has no poses on {topic}" if topic else f"has {len(chosen)} topics of poses"
            there = [*poses, *moving]
            listed = f"topics of poses: {', '.join(there[:12])}" if there else f"topics: {bags.list_topics(reader)}"
            raise DataError(path, f"{problem} ({listed})", "name the topic of the trajectory")
        return _read_poses(path, reader, chosen[0])


def _is_static(connection: Connection) -> bool:
    """Returns whether a topic of transforms holds those that never change."""
    return connection.topic.rsplit("/", 1)[-1] == _STATIC


def _read_poses(path: Path, reader: AnyReader, topic: str) -> tuple[Trajectory, list[str]]:
    """Reads the poses on a topic, and says how many of them are left out."""
    poses: list[bags.PoseRow] = []
    clock = bags.Clock()
    for connection, logged, raw in reader.messages([c for c in reader.connections if c.topic == topic]):
        message: Any = reader.deserialize(raw, connection.msgtype)
        if connection.msgtype == bags.PATH_TYPE:
            poses = [bags.pose_of(bags.POSE_TYPE, pose, bags.stamp_of(pose)) for pose in message.poses]
        else:
            poses.append(bags.pose_of(connection.msgtype, message, clock.stamp(topic, message, logged)))
    trajectory = bags.trajectory_of(poses)
    if trajectory is None and len(poses) > 1 and not any(pose[0] for pose in poses):
        raise DataError(path, f"holds a path without stamps on {topic}", "name a topic whose poses have stamps")
    at_once = (
        trajectory is not None and bool(clock.unstamped) and trajectory.stamps_us[-1] - trajectory.stamps_us[0] < _AT_ONCE_US
    )
    if trajectory is None or at_once:
        why = ": their headers have no stamps, and all were recorded at once" if at_once else ""
        raise DataError(path, f"holds no two poses at different times on {topic}{why}", "name another topic")
    return trajectory, clock.notes + bags.note_left_out(poses, topic)


def _read_transforms(
    path: Path, reader: AnyReader, connections: list[Connection], frame: str | None
) -> tuple[Trajectory, list[str]]:
    """Reads the pose of a frame from the transforms on some topics, and says how many of them are left out."""
    transforms = Transforms()
    for connection, logged, raw in reader.messages(connections):
        message: Any = reader.deserialize(raw, connection.msgtype)
        transforms.add(message, connection.topic, logged)
    try:
        return transforms.trace(transforms.choose(frame)), transforms.notes
    except ValueError as error:
        raise DataError(path, str(error), "name another frame, or a topic of poses") from error
