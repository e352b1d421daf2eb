"""Keys and poses of someone's own graph, checked where they come in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import gtsam
import numpy as np

from mqslam.backend.pose_graph import pose_of
from mqslam.core import se2
from mqslam.errors import ConfigError
from mqslam.factors.between import lifted_between

Keys: TypeAlias = Callable[[int], int] | Sequence[int]
"""GTSAM's key of each scan by its number: a function, or a sequence with a key for every scan."""
Pose: TypeAlias = type[gtsam.Pose2] | type[gtsam.Pose3]
Between: TypeAlias = gtsam.BetweenFactorPose2 | gtsam.BetweenFactorPose3


def list_keys(keys: Keys, count: int) -> list[int]:
    """Returns the keys of a number of scans.

    Raises:
        ConfigError: there are too few, or two of them are the same.
    """
    if not callable(keys) and len(keys) < count:
        raise ConfigError(f"keys: holds {len(keys)} keys for {count} scans; give one for every scan")
    listed = [int(keys(k) if callable(keys) else keys[k]) for k in range(count)]
    check_apart(listed)
    return listed


def check_apart(keys: Sequence[int]) -> None:
    """Checks that no two keys are the same.

    Raises:
        ConfigError: two of them are.
    """
    seen: set[int] = set()
    for key in keys:
        if key in seen:
            name = gtsam.DefaultKeyFormatter(key)
            raise ConfigError(f"keys: two poses have the key {name}; give every scan and submap a key of its own")
        seen.add(key)


def choose_lift(pose: Pose) -> Callable[[gtsam.BetweenFactorPose2], Between]:
    """Returns what makes a factor between planar poses one between poses of the graph.

    Args:
        pose: what the poses of the graph are.

    Raises:
        ConfigError: they are neither planar poses nor poses in space.
    """
    if pose is gtsam.Pose2:
        return lambda factor: factor
    if pose is gtsam.Pose3:
        return lifted_between
    raise ConfigError(f"pose: {pose} is no pose of a scan; give gtsam.Pose2 or gtsam.Pose3")


def read_poses(values: gtsam.Values, keys: Sequence[int]) -> se2.Array:
    """Returns the poses (N, 3) of keys, x [m], y [m], yaw [rad], the yaw unwrapped; those in space as seen from above.

    Raises:
        ConfigError: a key has no value, or one that is no pose.
    """
    poses = np.empty((len(keys), 3))
    for k, key in enumerate(keys):
        name = gtsam.DefaultKeyFormatter(key)
        if not values.exists(key):
            raise ConfigError(f"values: holds no pose for scan {k} (key {name}); give every scan a pose")
        try:
            poses[k] = pose_of(values, key)
        except RuntimeError as error:
            raise ConfigError(f"values: {name}, the key of scan {k}, is no pose; give a Pose2 or a Pose3") from error
    poses[:, 2] = np.unwrap(poses[:, 2])
    return poses


def find_pose_kind(values: gtsam.Values, key: int) -> Pose:
    """Returns whether a pose is planar or one in space."""
    return gtsam.Pose3 if values.dims()[key] == 6 else gtsam.Pose2
