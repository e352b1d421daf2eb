"""Right trajectories made wrong, each in one way that real ones are: what an audit should tell of them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from bench.scorer import headings, turn
from evo.core import lie_algebra
from evo.core.trajectory import PoseTrajectory3D
from numpy.typing import NDArray

Array = NDArray[np.float64]
Distortion = Callable[[Array, Array], tuple[Array, Array]]
"""Makes stamps (N,) [s] and poses (N, 3) [m, m, rad] wrong."""

_SEED = 1  # of jitter


def distort(track: PoseTrajectory3D, distortion: Distortion) -> PoseTrajectory3D:
    """Returns a trajectory made wrong."""
    poses = np.column_stack([track.positions_xyz[:, :2], np.unwrap(headings(track))])
    stamps, poses = distortion(np.asarray(track.timestamps), poses)
    matrices = [lie_algebra.se3(turn(yaw), np.array([x, y, 0.0])) for x, y, yaw in poses]
    return PoseTrajectory3D(poses_se3=matrices, timestamps=stamps)


def _stretch(factor: float, stamps: Array, poses: Array) -> tuple[Array, Array]:
    return stamps, poses * [factor, factor, 1.0]


def _hasten(speed: float, stamps: Array, poses: Array) -> tuple[Array, Array]:
    """Adds a speed [m/s] wherever the vehicle moves."""
    steps, seconds = np.diff(poses[:, :2], axis=0), np.diff(stamps)
    moves = np.hypot(*steps.T) > 0.1 * seconds
    ahead = np.column_stack([np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])])
    return stamps, _chain(poses[0, :2], steps + ahead * (speed * seconds * moves)[:, None], poses[:, 2])


def _drift(degrees: float, stamps: Array, poses: Array) -> tuple[Array, Array]:
    """Turns the yaw by so many degrees in 100 m."""
    return stamps, _bend(_travel(poses) * np.radians(degrees) / 100.0, poses)


def _bend_once(degrees: float, over_m: float, stamps: Array, poses: Array) -> tuple[Array, Array]:
    """Turns the yaw by some degrees, evenly over a stretch around the middle of the path."""
    return stamps, _bend(np.radians(degrees) * np.clip(_pass_middle(poses) / over_m + 0.5, 0.0, 1.0), poses)


def _bend(off: Array, poses: Array) -> Array:
    """Returns poses whose yaw is off by an angle (N,) [rad], and whose steps are turned with it."""
    steps = np.diff(poses[:, :2], axis=0)
    c, s = np.cos(off[:-1]), np.sin(off[:-1])
    turned = np.column_stack([c * steps[:, 0] - s * steps[:, 1], s * steps[:, 0] + c * steps[:, 1]])
    return _chain(poses[0, :2], turned, poses[:, 2] + off)


def _travel(poses: Array) -> Array:
    """Returns the path (N,) travelled up to each pose [m]."""
    return np.r_[0.0, np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))]


def _pass_middle(poses: Array) -> Array:
    """Returns the path (N,) from the middle of the drive to each pose [m], negative before it."""
    travelled = _travel(poses)
    return np.asarray(travelled - 0.5 * travelled[-1])


def _move_left(left_m: Array, poses: Array) -> Array:
    """Returns poses that are moved to their left by some metres (N,)."""
    left = np.column_stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2]), np.zeros(len(poses))])
    return poses + left_m[:, None] * left


def _weave(size_m: float, period_s: float, stamps: Array, poses: Array) -> tuple[Array, Array]:
    return stamps, _move_left(size_m * np.sin(2.0 * np.pi * (stamps - stamps[0]) / period_s), poses)


def _wobble(degrees: float, period_s: float, stamps: Array, poses: Array) -> tuple[Array, Array]:
    """Lets the yaw swing, and leaves the places as they are."""
    swing = np.radians(degrees) * np.sin(2.0 * np.pi * (stamps - stamps[0]) / period_s)
    return stamps, poses + np.column_stack([np.zeros((len(poses), 2)), swing])


def _swerve(size_m: float, over_m: float, stamps: Array, poses: Array) -> tuple[Array, Array]:
    """Moves the poses to the left, to the right and back, once, from the middle of the path on."""
    share = np.clip(_pass_middle(poses) / over_m, 0.0, 1.0)
    return stamps, _move_left(size_m * np.sin(2.0 * np.pi * share), poses)


def _pass_beside(size_m: float, over_m: float, stamps: Array, poses: Array) -> tuple[Array, Array]:
    """Moves the second half of the drive to the north, more and more over a stretch around the middle of the path."""
    share = np.clip(_pass_middle(poses) / over_m + 0.5, 0.0, 1.0)
    return stamps, poses + share[:, None] * np.array([0.0, size_m, 0.0])


def _chain(start: Array, steps: Array, yaws: Array) -> Array:
    """Returns the poses (N, 3) that steps (N - 1, 2) [m] lead to from a place (2,) [m]."""
    return np.column_stack([np.vstack([start[None], start + np.cumsum(steps, axis=0)]), yaws])


def _tear(size_m: float, over_m: float, back: bool, stamps: Array, poses: Array) -> tuple[Array, Array]:
    """Moves all that comes after the middle to the north-east, over so much path; back again where it is a bump."""
    along = _pass_middle(poses) / over_m
    share = np.clip(1.0 - np.abs(along), 0.0, 1.0) if back else np.clip(along, 0.0, 1.0)
    return stamps, poses + share[:, None] * np.array([0.8 * size_m, 0.6 * size_m, 0.0])


def _shake(sigma_m: float, stamps: Array, poses: Array) -> tuple[Array, Array]:
    noise = np.random.default_rng(_SEED).normal(0.0, sigma_m, (len(poses), 2))
    return stamps, poses + np.column_stack([noise, np.zeros(len(poses))])


def _mount(degrees: float, left_m: float, stamps: Array, poses: Array) -> tuple[Array, Array]:
    """Gives the poses of something that is turned against the sensor, and mounted beside it."""
    beside = left_m * np.column_stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])])
    return stamps, np.column_stack([poses[:, :2] + beside, poses[:, 2] + np.radians(degrees)])


def _swap(stamps: Array, poses: Array) -> tuple[Array, Array]:
    half = len(poses) // 2
    return stamps, np.vstack([poses[half:], poses[:half]])


DISTORTIONS: dict[str, Distortion] = {
    "none": lambda stamps, poses: (stamps, poses),
    "all distances x 1.003": partial(_stretch, 1.003),
    "all distances x 1.01": partial(_stretch, 1.01),
    "0.05 m/s too fast": partial(_hasten, 0.05),
    "0.1 m/s too fast": partial(_hasten, 0.1),
    "yaw drifts by 0.05 deg per 100 m": partial(_drift, 0.05),
    "yaw drifts by 0.2 deg per 100 m": partial(_drift, 0.2),
    "yaw drifts by 0.5 deg per 100 m": partial(_drift, 0.5),
    "yaw drifts by 2 deg per 100 m": partial(_drift, 2.0),
    "a jump of 0.3 m": partial(_tear, 0.3, 0.01, False),
    "a jump of 0.6 m": partial(_tear, 0.6, 0.01, False),
    "a jump of 2 m": partial(_tear, 2.0, 0.01, False),
    "torn by 0.6 m over 50 m": partial(_tear, 0.6, 50.0, False),
    "torn by 2 m over 200 m": partial(_tear, 2.0, 200.0, False),
    "a bump of 1 m over 50 m": partial(_tear, 1.0, 50.0, True),
    "jitter of 0.02 m": partial(_shake, 0.02),
    "jitter of 0.1 m": partial(_shake, 0.1),
    "0.05 s late": lambda stamps, poses: (stamps + 0.05, poses),
    "0.25 s late": lambda stamps, poses: (stamps + 0.25, poses),
    "mounted 1 deg off": partial(_mount, 1.0, 0.0),
    "mounted 0.2 m off": partial(_mount, 0.0, 0.2),
    "mirrored": lambda stamps, poses: (stamps, poses * [1.0, -1.0, -1.0]),
    "at rest": lambda stamps, poses: (stamps, np.repeat(poses[:1], len(poses), axis=0)),
    "halves swapped": _swap,
}
"""Every distortion by its name; the first one leaves the trajectory as it is."""

SLOW_DISTORTIONS: dict[str, Distortion] = {
    "none": DISTORTIONS["none"],
    "a bend of 3 deg over 200 m": partial(_bend_once, 3.0, 200.0),
    "a bend of 1 deg over 100 m": partial(_bend_once, 1.0, 100.0),
    "yaw swings by 0.3 deg in 20 s": partial(_wobble, 0.3, 20.0),
    "a weave of 0.15 m in 10 s": partial(_weave, 0.15, 10.0),
    "an S of 0.4 m over 10 m": partial(_swerve, 0.4, 10.0),
}
"""Distortions that no place of a map shows much of, by their names; the first one leaves the trajectory as it is."""

BESIDE: Distortion = partial(_pass_beside, 0.45, 600.0)
"""The second half of a drive lies 0.45 m beside the first."""
