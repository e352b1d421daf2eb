"""Crops the map around a place, before and after the place's correction, close enough to show the difference."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter
from scipy.spatial import cKDTree

from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.windows.inflation import centre_window, twist_points
from mqslam.core import se2
from mqslam.report.canvas import SQUARE, Curve, Drawing, Points, View, draw_world, find_common_view, mix_shades
from mqslam.report.spots import Spot

# which part of a place the picture shows; no other result depends on these values
_REACH_M = 80.0  # points farther from the sensor than this do not decide where a crop lies
_CLOSE_M, _FAR_M = 12.0, 80.0  # shortest and longest side of a crop
_SIDE = 40.0  # side of a crop divided by the size of the correction
_LEAST = 0.02  # weight of a point that the correction brings no closer to others; any gain outweighs it
_CELLS = 4  # cells along the side of a crop, in which weights are summed to choose the crop

Crop: TypeAlias = tuple[list[Points], list[Points]]
"""Points of a place before and after correction: for each, arrays (M, 2) x, y [m] in the frame of the spot's pose.

There is an array for each sweep of a window, or one for the earlier and one for the later stretch.
"""


def make_crop(sweeps: Sweeps, spot: Spot) -> Crop:
    """Crops a place to the square in which its correction reduces the distances of later from earlier points the most.

    Args:
        sweeps: the points that were judged.
        spot: the place.
    """
    before, after = _bend(sweeps, spot) if len(spot.stretches) == 1 else _move(sweeps, spot)
    half = len(before) // 2
    (a0, b0), (a1, b1) = ((np.concatenate(p[:half]), np.concatenate(p[half:])) for p in (before, after))
    near = np.abs(b1).max(axis=1, initial=0.0) <= _REACH_M
    most = max(2.0 * spot.off_m, 0.2)
    gained = np.full(np.count_nonzero(near), _LEAST * most)
    if len(a0):
        gained += measure_distances(b0[near], a0, most) - measure_distances(b1[near], a1, most)
    view = find_heaviest_square(b1[near], gained, float(np.clip(_SIDE * spot.off_m, _CLOSE_M, _FAR_M)))
    return [p[view.contains(p)] for p in before], [p[view.contains(p)] for p in after]


def draw_crop(crop: Crop) -> list[bytes]:
    """Draws a crop before and after correction, as two PNG files; the earliest sweep or pass is blue, the last is orange."""
    shown = [points for points in (*crop[0], *crop[1]) if len(points)]
    half = 0.5 * _CLOSE_M
    view = find_common_view(shown, SQUARE) if shown else View(-half, half, -half, half)
    drawings = []
    for passes in crop:
        strengths = 0.4 + 0.4 * np.abs(np.linspace(-1.0, 1.0, len(passes)))  # the first and the last stand out most
        looks = zip(mix_shades(len(passes)), passes, strengths.tolist(), strict=True)
        drawings.append(Drawing((), [Curve("", colour, points, ".", 3.5, strength) for colour, points, strength in looks]))
    return draw_world(drawings, view=view, is_small=True)


def find_heaviest_square(points: Points, weights: NDArray[np.float64], side: float) -> View:
    """Returns the square whose points have the largest sum of weights; for no points, a square around the origin.

    Squares are tried in steps of their side divided by `_CELLS`.

    Args:
        points: (N, 2) x, y [m].
        weights: (N,) weight of each point.
        side: side of the square [m].
    """
    if not len(points):
        return View(-0.5 * side, 0.5 * side, -0.5 * side, 0.5 * side)
    cell = side / _CELLS
    low = np.floor(points.min(axis=0) / cell).astype(np.int64)
    column, row = (np.floor(points / cell).astype(np.int64) - low).T
    shape = (int(column.max()) + 1, int(row.max()) + 1)
    sums = np.bincount(column * shape[1] + row, weights=weights, minlength=shape[0] * shape[1]).reshape(shape)
    together = uniform_filter(np.pad(sums, _CELLS), size=_CELLS, mode="constant")
    at = np.array(np.unravel_index(np.argmax(together), together.shape)) - _CELLS + low  # the square's midpoint
    x, y = (at * cell).tolist()
    return View(x - 0.5 * side, x + 0.5 * side, y - 0.5 * side, y + 0.5 * side)


def measure_distances(points: Points, others: Points, most: float) -> NDArray[np.float64]:
    """Returns the distance (N,) [m] from each of `points` (N, 2) [m] to the nearest of `others` (M, 2), at most `most`."""
    distances, _ = cKDTree(others).query(points, distance_upper_bound=most)
    return np.asarray(np.minimum(distances, most))


def _bend(sweeps: Sweeps, spot: Spot) -> Crop:
    """Returns the points of a window, an array (M, 2) [m] per sweep, without and with the correction of the window."""
    begin, end = spot.stretches[0][0], spot.stretches[0][-1] + 1
    points, into = centre_window(sweeps, begin, end)
    mended = twist_points(points, into, spot.correction / (end - begin)).points
    cuts = sweeps.begins[begin + 1 : end] - sweeps.begins[begin]
    return np.split(points.points, cuts), np.split(mended, cuts)


def _move(sweeps: Sweeps, spot: Spot) -> Crop:
    """Returns the points (M, 2) [m] of a place's two stretches, without and with the correction of the later stretch."""
    earlier, later = (sweeps.local(part, spot.pose).points for part in spot.stretches)
    return [earlier, later], [earlier, se2.transform(spot.correction, later)]
