"""Polygons and broken lines of a city's plan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.simulator.parts import Array


def offset_line(line: Array, distances: Array, *, closed: bool) -> Array:
    """Moves every piece of a broken line to its left, and lets the pieces meet again.

    Args:
        line: (N, 2) [m]; the last point of a closed line is joined to its first.
        distances: of every piece [m]: (N,) of a closed line, (N - 1,) of an open one.
        closed: whether the line is a polygon.

    Returns:
        The moved points (N, 2) [m].
    """
    after = np.roll(line, -1, axis=0) if closed else line[1:]
    along = after - line[: len(after)]
    along /= np.hypot(*along.T)[:, None]
    normal = np.c_[-along[:, 1], along[:, 0]]
    first, second = np.arange(len(line)) - 1, np.arange(len(line))  # the pieces before and after each point
    if not closed:
        first[0], second[-1] = 0, len(along) - 1
    n, m, a, b = normal[first], normal[second], distances[first], distances[second]
    cross = n[:, 0] * m[:, 1] - n[:, 1] * m[:, 0]
    straight = np.abs(cross) < 1e-3
    cross[straight] = 1.0
    meet = np.c_[a * m[:, 1] - b * n[:, 1], b * n[:, 0] - a * m[:, 0]] / cross[:, None]
    meet[straight] = 0.5 * (a[:, None] * n + b[:, None] * m)[straight]
    return np.asarray(line + meet)


def contains(polygon: Array, points: Array) -> NDArray[np.bool_]:
    """Returns which of the points (N, 2) lie in a polygon (K, 2)."""
    x, y = points[:, :1], points[:, 1:]
    a, b = polygon, np.roll(polygon, -1, axis=0)
    crossed = (a[:, 1] > y) != (b[:, 1] > y)
    rise = np.where(crossed, b[:, 1] - a[:, 1], 1.0)
    return np.asarray(np.sum(crossed & (x < a[:, 0] + (y - a[:, 1]) / rise * (b[:, 0] - a[:, 0])), axis=1) % 2 == 1)


def distance_to_pieces(points: Array, starts: Array, ends: Array) -> Array:
    """Returns the distances (N, K) [m] of points (N, 2) from straight pieces, given by starts and ends (K, 2)."""
    along = ends - starts
    late = points[:, None] - starts
    share = np.clip((late * along).sum(axis=2) / (along**2).sum(axis=1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(late - share[..., None] * along, axis=2))


def draw_inside(rng: np.random.Generator, polygon: Array, number: int) -> Array:
    """Draws points (M, 2) in a polygon: as many as of `number` points in the box around it."""
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    points = rng.uniform(low, high, (number, 2))
    return np.asarray(points[contains(polygon, points)])
