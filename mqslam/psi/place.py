"""Renders returns as points: their positions in the world's frame under a motion, with covariances and derivatives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numba as nb
import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.motion import MotionModel, integrate, raise_to
from mqslam.core.scans import Returns


class Beam(NamedTuple):
    """The measurement errors of the sensor.

    Args:
        sigma_range: standard deviation of a return along the ray [m].
        sigma_azimuth: standard deviation of a return across the ray [rad].
        doppler_beta: range shift per closing speed [s]; the true range is the measured range plus beta times closing speed.
    """

    sigma_range: float
    sigma_azimuth: float
    doppler_beta: float = 0.0


class PointArrays(NamedTuple):
    """The fields of a `PointSet` as a named tuple, which the compiled functions take."""

    points: NDArray[np.float64]
    jacobians: NDArray[np.float64]
    covariances: NDArray[np.float64]
    times: NDArray[np.float64]
    rays: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PointSet:
    """Points, each rendered from one return. The "world frame" is the one in which the start pose is given, such as a map's.

    Args:
        points: (N, 2) x, y [m], world frame.
        jacobians: (N, 2, Q) derivatives of x, y by the variables of the state; from `place`, these are the start pose (x, y
            [m], yaw [rad]) and then the P motion parameters. They may be empty (0, 2, 0) for points that do not move.
        covariances: (N, 3) xx, xy, yy [m^2] of each point, world frame.
        times: (N,) [s] since the recording's start.
        rays: (N, 2) unit vectors from the sensor to each point, world frame; empty (0, 2) where viewing directions
            play no part in the score.
    """

    points: NDArray[np.float64]
    jacobians: NDArray[np.float64]
    covariances: NDArray[np.float64]
    times: NDArray[np.float64]
    rays: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))

    def __len__(self) -> int:
        return len(self.points)

    @property
    def arrays(self) -> PointArrays:
        """The fields of the set as a named tuple, which the compiled functions take."""
        return PointArrays(self.points, self.jacobians, self.covariances, self.times, self.rays)


def rotate_covariances(covariances: NDArray[np.float64], yaw: float) -> NDArray[np.float64]:
    """Converts covariances (N, 3) xx, xy, yy [m^2] from a frame that is rotated by yaw [rad] to the unrotated frame."""
    c, s = np.cos(yaw), np.sin(yaw)
    xx, xy, yy = covariances.T
    return np.column_stack(
        [
            c * c * xx - 2.0 * c * s * xy + s * s * yy,
            c * s * (xx - yy) + (c * c - s * s) * xy,
            s * s * xx + 2.0 * c * s * xy + c * c * yy,
        ]
    )


def place(returns: Returns, t0: float, start: se2.Array, theta: se2.Array, model: MotionModel, beam: Beam) -> PointSet:
    """Renders returns as points in the world frame, under a motion of the sensor that begins at a start pose.

    Args:
        returns: returns to render.
        t0: time of the start pose [s since the recording's start].
        start: (3,) x, y [m], yaw [rad] of the sensor at t0, world frame.
        theta: (P,) motion parameters.
        model: motion model, which says what the parameters mean.
        beam: the sensor's errors.
    """
    points, jacobians, covariances, rays = place_arrays(
        returns.ranges,
        returns.azimuths,
        returns.times - t0,
        np.asarray(start, dtype=np.float64),
        np.asarray(theta, dtype=np.float64),
        model.arrays,
        beam,
    )
    return PointSet(points, jacobians, covariances, returns.times, rays)


@register_jitable
def compute_beam_covariance(
    ranges: NDArray[np.float64], ux: NDArray[np.float64], uy: NDArray[np.float64], beam: Beam
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Returns the terms xx, xy, yy [m^2] of the covariance of returns whose ray points along the unit vector (ux, uy).

    Vectors and covariances have the same frame. `ranges` [m], `ux`, `uy` and the results are arrays (N,), or single numbers
    in a compiled function.
    """
    along = beam.sigma_range * beam.sigma_range
    across = (ranges * beam.sigma_azimuth) ** 2
    return along * ux * ux + across * uy * uy, (along - across) * ux * uy, along * uy * uy + across * ux * ux


@nb.njit(cache=True, nogil=True)
def place_arrays(
    ranges: NDArray[np.float64],
    azimuths: NDArray[np.float64],
    times: NDArray[np.float64],
    start: NDArray[np.float64],
    theta: NDArray[np.float64],
    model: tuple[NDArray[np.int64], NDArray[np.int64]],
    beam: Beam,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Renders returns as points, like `place`, but takes and returns plain arrays.

    Args:
        ranges: (N,) measured ranges [m].
        azimuths: (N,) rad, in the frame of the sensor.
        times: (N,) s since the start pose; returns of the same azimuth are adjacent.
        start: (3,) x, y [m], yaw [rad] of the sensor at the start, world frame.
        theta: (P,) motion parameters.
        model: components (P,) and powers (P,) of the motion model.
        beam: the sensor's errors.

    Returns:
        The points (N, 2), their jacobians (N, 2, 3 + P), covariances (N, 3) and rays (N, 2), as in a `PointSet`.
    """
    n, size = len(ranges), len(theta)
    components, powers = model
    beta = beam.doppler_beta
    poses, d_poses, twists = integrate(theta, components, powers, times)
    points = np.empty((n, 2))
    jacobians = np.empty((n, 2, 3 + size))
    covariances = np.empty((n, 3))
    rays = np.empty((n, 2))
    c0, s0 = np.cos(start[2]), np.sin(start[2])
    ca, sa, c, s = 1.0, 0.0, 1.0, 0.0
    for i in range(n):
        if i == 0 or azimuths[i] != azimuths[i - 1] or times[i] != times[i - 1]:  # returns of one azimuth have one time
            ca, sa = np.cos(azimuths[i]), np.sin(azimuths[i])
            c, s = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        r = ranges[i] + beta * (twists[i, 0] * ca + twists[i, 1] * sa)
        ahead, left = c * ca - s * sa, s * ca + c * sa  # the beam, in the frame of the window's start
        x, y = poses[i, 0] + r * ahead, poses[i, 1] + r * left
        dx, dy = c0 * x - s0 * y, s0 * x + c0 * y
        points[i, 0] = start[0] + dx
        points[i, 1] = start[1] + dy
        jacobians[i, 0, 0] = 1.0
        jacobians[i, 1, 0] = 0.0
        jacobians[i, 0, 1] = 0.0
        jacobians[i, 1, 1] = 1.0
        jacobians[i, 0, 2] = -dy
        jacobians[i, 1, 2] = dx
        for p in range(size):
            d_range = 0.0
            if beta != 0.0 and components[p] != 2:
                d_range = beta * raise_to(times[i], powers[p]) * (ca if components[p] == 0 else sa)
            jx = d_poses[i, 0, p] - d_poses[i, 2, p] * r * left + d_range * ahead
            jy = d_poses[i, 1, p] + d_poses[i, 2, p] * r * ahead + d_range * left
            jacobians[i, 0, 3 + p] = c0 * jx - s0 * jy
            jacobians[i, 1, 3 + p] = s0 * jx + c0 * jy
        ux, uy = c0 * ahead - s0 * left, s0 * ahead + c0 * left
        rays[i, 0], rays[i, 1] = ux, uy
        covariances[i, 0], covariances[i, 1], covariances[i, 2] = compute_beam_covariance(ranges[i], ux, uy, beam)
    return points, jacobians, covariances, rays


def beam_of(config: EstimatorConfig, doppler_beta: float) -> Beam:
    """Returns the sensor's errors from the settings and from its range shift per closing speed, `doppler_beta` [s]."""
    return Beam(config.sigma_range_m, config.sigma_azimuth, doppler_beta)
