"""Drives through a scene: the pose of the radar at any time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from mqslam.core import se2
from mqslam.simulator.scene import BLOCK, LANE, Array, Scene

_ROUND = (BLOCK[0] + 2.0 * LANE, BLOCK[1] + 2.0 * LANE)  # size of one round in the right-hand lane, along x and y [m]
_CORNER_MPS, _ACCELERATION = 5.0, 2.0  # speed in corners [m/s], largest acceleration [m/s^2]
_CURVATURE, _RAMP_M = 0.11, 5.0  # curvature in the middle of a corner [1/m], and length over which it rises and falls


class Drive(ABC):
    """A smooth motion of the sensor through a scene."""

    @abstractmethod
    def poses(self, times: Array) -> se2.Array:
        """Returns the poses (N, 3) x, y [m], yaw [rad] at times (N,) [s] in the scene's frame; the yaw is not wrapped."""

    @abstractmethod
    def twists(self, times: Array) -> se2.Array:
        """Returns the body velocities (N, 3) forward [m/s], left [m/s], yaw rate [rad/s] at times (N,) [s]."""


@dataclass(frozen=True)
class ConstantDrive(Drive):
    """A drive along an arc with an exactly constant twist.

    Args:
        v: forward speed [m/s].
        omega: yaw rate [rad/s].
        start: pose at time zero in the scene's frame, x [m], y [m], yaw [rad].
    """

    v: float
    omega: float
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def poses(self, times: Array) -> se2.Array:
        """Returns the poses (N, 3) x [m], y [m], yaw [rad] at times (N,) [s] in the scene's frame."""
        return se2.compose(np.array(self.start), se2.exp(np.array([self.v, 0.0, self.omega]), times))

    def twists(self, times: Array) -> se2.Array:
        """Returns the body velocities (N, 3) forward [m/s], left [m/s], yaw rate [rad/s] at times (N,) [s]."""
        return np.tile([self.v, 0.0, self.omega], (len(times), 1))


@dataclass(frozen=True)
class SampledDrive(Drive):
    """A drive along the cubic spline through sampled poses and rates; its first and last piece continue beyond the samples.

    Args:
        times: (N,) times of the samples [s], increasing.
        samples: (N, 3) poses x [m], y [m], yaw [rad] in the scene's frame; the yaw is not wrapped.
        rates: (N, 3) time derivatives of these poses [m/s, m/s, rad/s].
    """

    times: Array
    samples: se2.Array
    rates: se2.Array

    def poses(self, times: Array) -> se2.Array:
        """Returns the poses (N, 3) x [m], y [m], yaw [rad] at times (N,) [s] in the scene's frame."""
        f, _, a, b, ra, rb = self._find_intervals(times)
        return (
            (1.0 + 2.0 * f) * (1.0 - f) ** 2 * a
            + f * (1.0 - f) ** 2 * ra
            + f**2 * (3.0 - 2.0 * f) * b
            - f**2 * (1.0 - f) * rb
        )

    def twists(self, times: Array) -> se2.Array:
        """Returns the body velocities (N, 3) forward [m/s], left [m/s], yaw rate [rad/s] at times (N,) [s]."""
        f, step, a, b, ra, rb = self._find_intervals(times)
        rate = (6.0 * f * (1.0 - f) * (b - a) + (1.0 - f) * (1.0 - 3.0 * f) * ra + f * (3.0 * f - 2.0) * rb) / step
        yaw = self.poses(times)[:, 2]
        c, s = np.cos(yaw), np.sin(yaw)
        ahead, left = c * rate[:, 0] + s * rate[:, 1], c * rate[:, 1] - s * rate[:, 0]
        return np.column_stack([ahead, left, rate[:, 2]])

    def _find_intervals(self, times: Array) -> tuple[Array, Array, se2.Array, se2.Array, se2.Array, se2.Array]:
        """Finds the intervals between samples for times (N,) [s].

        Returns:
            (1) The share (N, 1) of each time's interval that has passed by then, below 0 or above 1 beyond the samples, (2)
            the duration (N, 1) of the interval [s], (3, 4) the samples (N, 3) at its ends, and (5, 6) the rates (N, 3) at
            its ends, multiplied by the duration.
        """
        i = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        step = (self.times[i + 1] - self.times[i])[:, None]
        share = (times - self.times[i])[:, None] / step
        return share, step, self.samples[i], self.samples[i + 1], self.rates[i] * step, self.rates[i + 1] * step


def make_loop_drive(duration_s: float, *, speed: float = 9.0) -> SampledDrive:
    """Makes a drive of counter-clockwise rounds of a street scene's middle block, in the right-hand lane.

    At the default speed, one round takes about 48 s. The drive starts at the midpoint of the block's side with the least y,
    heading along x.

    Args:
        duration_s: duration of the drive [s].
        speed: speed on the straights [m/s].
    """
    places, lap, curvatures, limits = _lay_lap(speed)
    distance = np.arange(0.0, speed * duration_s + 10.0, 0.1)
    limit = np.interp(distance % places[-1], places, limits)
    speeds = limit_acceleration(distance, limit, _ACCELERATION)
    step = 2.0 * np.diff(distance) / (speeds[1:] + speeds[:-1])
    reached = np.concatenate([[0.0], np.cumsum(step)])
    times = np.arange(0.0, duration_s + 0.5, 0.02)
    i = np.clip(np.searchsorted(reached, times, side="right") - 1, 0, len(step) - 1)
    late, gain = times - reached[i], (speeds[i + 1] - speeds[i]) / step[i]
    place = (distance[i] + speeds[i] * late + 0.5 * gain * late**2) % places[-1]
    v = speeds[i] + gain * late
    poses = se2.interpolate(places, lap, place)
    poses[:, 2] = np.unwrap(poses[:, 2])
    rates = np.c_[v * np.cos(poses[:, 2]), v * np.sin(poses[:, 2]), v * np.interp(place, places, curvatures)]
    return SampledDrive(times, poses, rates)


def _lay_lap(speed: float) -> tuple[Array, se2.Array, Array, Array]:
    """Lays one round of the middle block, with the speed limit `speed` [m/s] on its straights.

    Returns:
        Distances (N,) along the round [m], and at these distances the poses (N, 3) [m, m, rad] in the scene's frame, the
        curvatures (N,) [1/m] and the speed limits (N,) [m/s].
    """
    corner, bend, spacing = _lay_corner()
    poses = [np.array([[0.0, -_ROUND[1] / 2.0, 0.0]])]
    places, curvatures, limits = [np.zeros(1)], [np.zeros(1)], [np.full(1, speed)]

    def add(piece: se2.Array, curvature: Array, spacing: float, limit: float) -> None:
        poses.append(se2.compose(poses[-1][-1], piece))
        places.append(places[-1][-1] + spacing * np.arange(1, len(piece) + 1))
        curvatures.append(curvature)
        limits.append(np.full(len(piece), limit))

    def add_straight(length: float) -> None:
        number = max(1, round(length / 0.25))
        piece = np.linspace([0.0, 0.0, 0.0], [length, 0.0, 0.0], number + 1)[1:]
        add(piece, np.zeros(number), length / number, speed)

    along, across = (side - 2.0 * corner[-1, 0] for side in _ROUND)
    add_straight(along / 2.0)
    for length in (across, along, across, along / 2.0):
        add(corner, bend, spacing, _CORNER_MPS)
        add_straight(length)
    return np.concatenate(places), np.concatenate(poses), np.concatenate(curvatures), np.concatenate(limits)


def _lay_corner() -> tuple[se2.Array, Array, float]:
    """Lays a left-hand corner of 90 degrees whose curvature [1/m] rises and falls linearly.

    Returns:
        Poses (N, 3) [m, m, rad] in the frame of the corner's start, without the start itself; the curvatures (N,) [1/m]
        at these poses; the distance between successive poses [m].
    """
    length = np.pi / 2.0 / _CURVATURE + _RAMP_M
    place = np.linspace(0.0, length, round(length / 0.1) + 1)
    bend = _CURVATURE * np.minimum(1.0, np.minimum(place, length - place) / _RAMP_M)
    mean = 0.5 * (bend[1:] + bend[:-1])
    spacing = place[1]
    mean *= np.pi / 2.0 / (mean.sum() * spacing)  # so that the corner turns by exactly 90 degrees
    poses = np.zeros((len(place), 3))
    for i, k in enumerate(mean):
        poses[i + 1] = se2.compose(poses[i], se2.exp(np.array([1.0, 0.0, k]), spacing))
    return poses[1:], bend[1:], float(spacing)


def limit_acceleration(distance: Array, limit: Array, acceleration: float) -> Array:
    """Returns the largest speeds (N,) [m/s] along a path that exceed neither the speed limits nor an acceleration.

    Args:
        distance: (N,) distances along the path [m], increasing by equal steps.
        limit: (N,) speed limits at these distances [m/s].
        acceleration: largest acceleration, and largest deceleration [m/s^2].
    """
    squared = limit**2
    gain = 2.0 * acceleration * (distance[1] - distance[0])
    for i in range(1, len(squared)):
        squared[i] = min(squared[i], squared[i - 1] + gain)
    for i in range(len(squared) - 2, -1, -1):
        squared[i] = min(squared[i], squared[i + 1] + gain)
    return np.sqrt(squared)


def make_tunnel_drive(duration_s: float) -> SampledDrive:
    """Makes a drive of `duration_s` [s] along x from x = -60 m; the speed varies from 7 to 13 m/s with a period of 24 s."""
    times = np.arange(0.0, duration_s + 0.5, 0.02)
    phase, period = 2.0 * np.pi * times / 24.0, 24.0 / (2.0 * np.pi)
    zeros = np.zeros_like(times)
    poses = np.column_stack([-60.0 + 10.0 * times + 3.0 * period * (1.0 - np.cos(phase)), zeros, zeros])
    return SampledDrive(times, poses, np.column_stack([10.0 + 3.0 * np.sin(phase), zeros, zeros]))


def clear_way(scene: Scene, drive: Drive, duration_s: float) -> Scene:
    """Returns the scene with moving vehicles that would touch the radar's own vehicle shifted along their lanes.

    A vehicle that would touch the radar's vehicle after every shift stays in its place. The drive lasts `duration_s`.
    """
    times = np.arange(0.0, duration_s, 0.05)
    poses = drive.poses(times)
    movers = scene.movers.copy()
    for mover in movers:
        places = mover[4] + np.arange(0.0, mover[3], 10.0)
        mover[4] = next((place for place in places if not meets(mover, place, times, poses)), mover[4])
    return replace(scene, movers=movers)


def meets(mover: Array, place: float, times: Array, poses: se2.Array) -> bool:
    """Returns whether another vehicle, which starts at `place` [m] along its lane, would touch the radar's own vehicle.

    The other vehicle is `mover`, a row (9,) of `Scene.movers`. The radar's vehicle has poses (N, 3) [m, m, rad] in the
    scene's frame at times (N,) [s].
    """
    x, y, _ = poses.T
    c, s = np.cos(mover[2]), np.sin(mover[2])
    along, across = c * (x - mover[0]) + s * (y - mover[1]), c * (y - mover[1]) - s * (x - mover[0])
    ahead = along - (place + mover[5] * times) % mover[3]
    return bool(np.any((np.abs(across) < 0.5 * mover[7] + 1.2) & (np.abs(ahead) < 0.5 * mover[6] + 2.5)))
