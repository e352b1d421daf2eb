"""What the poses of a bag are the poses of, by the frame that their messages name: radar, vehicle or something on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mqslam.core import se2
from mqslam.core.sensors import Mount
from mqslam.core.trajectory import Trajectory
from mqslam.formats.lidars.mounts import Mounts
from mqslam.formats.shared.bags import name_frame


@dataclass(frozen=True, slots=True)
class Frames:
    """The frames of a bag.

    Args:
        radar: frame of the radar's messages.
        mount: where the radar sits on the vehicle, or None where the bag does not say it.
        placed: the static transforms.
    """

    radar: str
    mount: Mount | None
    placed: Mounts

    def place_odometry(self, odometry: Trajectory, topic: str, frame: str) -> tuple[Trajectory, str]:
        """Returns odometry as the motion of the vehicle if the mount is known, else of the radar, and how it was understood.

        Odometry of a frame that no transform places is taken as that of the vehicle, whose wheels make it.

        Args:
            odometry: poses.
            topic: that they come from.
            frame: whose poses they are, or "".
        """
        if self.mount is None:
            return odometry, f"odometry from {topic} is taken as the motion of the radar itself"
        on_vehicle = self._find(frame)
        if on_vehicle is None:
            return odometry, f"odometry from {topic} is taken as the motion of the vehicle, on which {self.radar} sits"
        carried = Trajectory(odometry.stamps_us, se2.compose(odometry.poses, se2.inverse(on_vehicle)))
        return carried, f"odometry from {topic} is the motion of {frame}"

    def place_truth(self, truth: Trajectory, topic: str, frame: str) -> tuple[Trajectory, str]:
        """Returns ground truth as poses of the radar where the transforms say how to carry it, and how it was understood.

        Args:
            truth: poses.
            topic: that they come from.
            frame: whose poses they are, or "".
        """
        if frame and name_frame(frame) == name_frame(self.radar):
            return truth, f"ground truth from {topic} is the pose of the radar"
        on_vehicle = self._find(frame)
        if on_vehicle is None:
            return truth, f"ground truth from {topic} is taken as the pose of the radar itself"
        if self.mount is None:
            return truth, f"ground truth from {topic} is the pose of {frame}; where the radar sits on it is not stated"
        to_radar = se2.compose(se2.inverse(on_vehicle), self.mount.pose)
        carried = Trajectory(truth.stamps_us, se2.compose(truth.poses, to_radar))
        return carried, f"ground truth from {topic} is the pose of {frame}, carried to the radar by {self.mount.source}"

    def is_of_vehicle(self, frame: str) -> bool:
        """Returns whether a frame is the vehicle's own, on which the bag does not place the radar."""
        on_vehicle = self._find(frame)
        apart = name_frame(frame) != name_frame(self.radar)
        return self.mount is None and apart and on_vehicle is not None and not on_vehicle.any()

    def _find(self, frame: str) -> se2.Array | None:
        """Returns the pose (3,) of a frame on the vehicle, or None where no finite transforms place it."""
        found = self.placed.find(frame, "") if frame else None
        return found.pose if found is not None and np.isfinite(found.pose).all() else None
