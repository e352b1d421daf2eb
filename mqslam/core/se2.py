"""Planar rigid motions and poses as arrays (..., 3): x [m], y [m], yaw [rad], REP 103 (x forward, y left).

Functions wrap the yaw only where their docstrings say so.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_CLOSE = 0.1  # share of the usual time step; poses that are closer in time show noise, not a velocity


def wrap(angle: ArrayLike) -> Array:
    """Wraps an angle [rad] to [-pi, pi); an angle in this interval stays exactly the same."""
    given = np.asarray(angle, dtype=np.float64)
    return np.where((given >= -np.pi) & (given < np.pi), given, (given + np.pi) % (2.0 * np.pi) - np.pi)


def compose(a: ArrayLike, b: ArrayLike) -> Array:
    """Composes two poses: converts pose b from the frame of pose a to the frame in which pose a is given."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        [
            a[..., 0] + c * b[..., 0] - s * b[..., 1],
            a[..., 1] + s * b[..., 0] + c * b[..., 1],
            a[..., 2] + b[..., 2],
        ],
        axis=-1,
    )


def inverse(a: ArrayLike) -> Array:
    """Returns the inverse of a pose or motion."""
    a = np.asarray(a, dtype=np.float64)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack([-c * a[..., 0] - s * a[..., 1], s * a[..., 0] - c * a[..., 1], -a[..., 2]], axis=-1)


def between(a: ArrayLike, b: ArrayLike) -> Array:
    """Returns pose b in the frame of pose a."""
    return compose(inverse(a), b)


def wrapped_between(a: ArrayLike, b: ArrayLike) -> Array:
    """Returns pose b in the frame of pose a, with its yaw in [-pi, pi)."""
    pose = between(a, b)
    pose[..., 2] = wrap(pose[..., 2])
    return pose


def subtract(a: Array, b: Array) -> Array:
    """Returns the difference a - b (..., 3) of poses, component by component, with its yaw wrapped to [-pi, pi)."""
    off = a - b
    off[..., 2] = wrap(off[..., 2])
    return off


def chain(motions: Iterable[Array], start: Array | None = None) -> Array:
    """Returns the poses (N + 1, 3) that result from composing N relative motions (3,) one after the other.

    Args:
        motions: each in the frame of the pose that it starts at.
        start: (3,) the first pose; None starts at the origin.
    """
    poses = [np.zeros(3) if start is None else start]
    for motion in motions:
        poses.append(compose(poses[-1], motion))
    return np.array(poses)


def integrate_steps(steps: Array) -> Array:
    """Composes steps (N, 3) to poses (N + 1, 3) that start at the origin: a faster `chain` without a loop.

    This function is meant for odometry, which has many more steps than a radar has scans. The sums are formed in another
    order than by `chain`, so the last digits of the result may differ.
    """
    yaw = np.concatenate([[0.0], np.cumsum(steps[:, 2])])
    c, s = np.cos(yaw[:-1]), np.sin(yaw[:-1])
    x = np.cumsum(c * steps[:, 0] - s * steps[:, 1])
    y = np.cumsum(s * steps[:, 0] + c * steps[:, 1])
    return np.column_stack([np.concatenate([[0.0], x]), np.concatenate([[0.0], y]), yaw])


def step_lengths(poses: Array) -> Array:
    """Returns the distances (N - 1,) [m] between successive poses (N, 3)."""
    return np.asarray(np.hypot(*np.diff(poses[:, :2], axis=0).T))


def path_lengths(poses: Array) -> Array:
    """Returns the length (N,) [m] of the path through poses (N, 3) up to each pose."""
    return np.concatenate([[0.0], np.cumsum(step_lengths(poses))])


def transform(pose: ArrayLike, points: ArrayLike) -> Array:
    """Converts points (N, 2) [m] from the frame of a pose to the frame in which the pose is given."""
    pose, points = np.asarray(pose, dtype=np.float64), np.asarray(points, dtype=np.float64)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray(points @ np.array([[c, s], [-s, c]]) + pose[:2])


def exp(twist: ArrayLike, duration: ArrayLike = 1.0) -> Array:
    """Returns the motion that a constant body twist (..., 3) vx, vy [m/s], omega [rad/s] makes in a duration (...) [s]."""
    d = np.asarray(twist, dtype=np.float64) * np.asarray(duration, dtype=np.float64)[..., None]
    a, b = _arc(d[..., 2])
    return np.stack([a * d[..., 0] - b * d[..., 1], b * d[..., 0] + a * d[..., 1], d[..., 2]], axis=-1)


def log(pose: ArrayLike) -> Array:
    """Returns the constant body twist (..., 3) that makes a motion in one second: the inverse of `exp` for |yaw| < 2 pi."""
    p = np.asarray(pose, dtype=np.float64)
    a, b = _arc(p[..., 2])
    n = a * a + b * b
    return np.stack([(a * p[..., 0] + b * p[..., 1]) / n, (-b * p[..., 0] + a * p[..., 1]) / n, p[..., 2]], axis=-1)


def _arc(w: Array) -> tuple[Array, Array]:
    """Returns sin(w)/w and (1 - cos(w))/w for angles w (...) [rad], with their limits 1 and 0 at w = 0."""
    a = np.sinc(w / np.pi)
    half = np.sinc(w / (2.0 * np.pi))
    return np.asarray(a), np.asarray(0.5 * w * half * half)


def adjoint(pose: ArrayLike) -> Array:
    """Returns the adjoint (3, 3) of a pose, which converts small motions from the pose's frame to its reference frame."""
    x, y, yaw = np.asarray(pose, dtype=np.float64)
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, y], [s, c, -x], [0.0, 0.0, 1.0]])


def rotate_covariance(covariance: Array, yaw: float) -> Array:
    """Converts a covariance (3, 3) of x, y, yaw from one frame to another, in which the first frame has yaw `yaw` [rad]."""
    turn = adjoint([0.0, 0.0, yaw])
    outside = turn @ covariance @ turn.T
    return np.asarray(0.5 * (outside + outside.T))


def normalise(errors: Array, covariances: Array) -> Array:
    """Returns the squared Mahalanobis distances (N,) of errors (N, 3) in x, y, yaw under their covariances (N, 3, 3).

    If the covariances are right, the distances follow a chi-square distribution with three degrees of freedom.
    """
    return np.asarray(np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[:, :, None])[:, :, 0]))


def scale_covariance(covariance: Array, factors: Array) -> Array:
    """Multiplies the variances of x, y and yaw in covariances (..., 3, 3) by factors (3,); correlations stay the same."""
    sigmas = np.sqrt(factors)
    return np.asarray(covariance * np.outer(sigmas, sigmas))


def covariance_of_inverse(pose: ArrayLike, covariance: Array) -> Array:
    """Converts the covariance (3, 3) of a pose (3,) to the covariance of the inverse pose.

    Each covariance is of x, y, yaw [m, m, rad] in the frame in which its pose is given.
    """
    x, y, yaw = np.asarray(pose, dtype=np.float64)
    lever = adjoint([x, y, 0.0])
    return rotate_covariance(lever @ covariance @ lever.T, -yaw)


def interpolate(times: ArrayLike, poses: ArrayLike, at: ArrayLike) -> Array:
    """Returns poses (M, 3) at times `at` (M,) on the constant-twist arcs through poses (N, 3) at increasing times (N,).

    Before the first and after the last time, the nearest arc between poses that `select_apart` keeps is continued. A single
    pose holds at all times.
    """
    t, p, q = np.asarray(times, dtype=np.float64), np.asarray(poses, dtype=np.float64), np.asarray(at, dtype=np.float64)
    if len(t) == 1:
        return np.repeat(p, len(q), axis=0)
    result = _on_arcs(t, p, q)
    outside = (q < t[0]) | (q > t[-1])
    if outside.any():
        knots = select_apart(t)
        result[outside] = _on_arcs(t[knots], p[knots], q[outside])
    return result


def _on_arcs(t: Array, p: Array, q: Array) -> Array:
    """Returns the poses (M, 3) at times q (M,) on the arcs through at least two poses p (N, 3) at times t (N,)."""
    i = np.clip(np.searchsorted(t, q, side="right") - 1, 0, len(t) - 2)
    step = wrapped_between(p[i], p[i + 1])
    fraction = (q - t[i]) / (t[i + 1] - t[i])
    return compose(p[i], exp(log(step), fraction))


def smooth(times: ArrayLike, poses: ArrayLike, at: ArrayLike) -> Array:
    """Returns poses (M, 3) at times `at` (M,) on the smooth curve through poses (N, 3) at increasing times (N,).

    Between poses the curve is cubic, with velocities from the neighbouring poses, so that the vehicle can begin
    and end a rotation between two poses, as on the road. Before the first and after the last time, the arc of constant
    twist between the nearest two poses is continued. Only poses that `select_apart` keeps are used, because two poses that
    are very close in time would give a velocity that is mostly noise. Fewer than three poses are joined as by `interpolate`.
    """
    from scipy.interpolate import CubicHermiteSpline  # here: it loads half of SciPy, and every command imports this module

    t, p, q = np.asarray(times, dtype=np.float64), np.asarray(poses, dtype=np.float64), np.asarray(at, dtype=np.float64)
    if len(t) < 3:
        return interpolate(t, p, q)
    knots = select_apart(t)
    t, p = t[knots], p[knots]
    unwrapped = np.column_stack([p[:, :2], np.unwrap(p[:, 2])])
    curve = CubicHermiteSpline(t, unwrapped, np.gradient(unwrapped, t, axis=0))
    result = np.asarray(curve(np.clip(q, t[0], t[-1])))
    outside = (q < t[0]) | (q > t[-1])
    if outside.any():
        result[outside] = interpolate(t, unwrapped, q[outside])
    return result


def find_poses_of_returns(times: ArrayLike, poses: ArrayLike, at: ArrayLike) -> Array:
    """Returns a sensor's poses (M, 3) at the times `at` (M,) of its returns, from poses (N, 3) at increasing times (N,).

    The poses lie on the curve of `smooth`. If all times of returns are times of poses, as for a lidar whose scan takes no
    time, the poses themselves are returned. A smooth curve could not follow the poses of scans that arrive in a burst.
    """
    t, q = np.asarray(times, dtype=np.float64), np.asarray(at, dtype=np.float64)
    nearest = np.minimum(np.searchsorted(t, q), len(t) - 1)
    if np.array_equal(t[nearest], q):
        return np.asarray(np.asarray(poses, dtype=np.float64)[nearest])
    return smooth(times, poses, at)


def select_apart(times: Array, share: float = _CLOSE) -> NDArray[np.int64]:
    """Returns the indices of the increasing times (N,) that are not duplicates.

    A time is a duplicate if it follows the last kept time by less than a share of the usual step, by default a tenth.
    """
    steps = np.diff(times)
    least = share * float(np.median(steps)) if len(steps) else 0.0
    if np.all(steps >= least):
        return np.arange(len(times))
    chosen = [0]
    for k, time in enumerate(times):
        if time - times[chosen[-1]] >= least:
            chosen.append(k)
    return np.array(chosen)
