"""Crops of a map before and after a correction, close enough to see what the correction mends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter
from scipy.spatial import cKDTree

from mqslam.auditing.judge import Audit
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.windows.inflation import centre_window, twist_points
from mqslam.config import AuditConfig
from mqslam.core import se2
from mqslam.report.figures.canvas import BLUE, ORANGE, View, encode_png, find_common_view, make_square
from mqslam.report.places.spots import WORST, Spot, find_worst_spots

# how a crop is placed in its picture; nothing but the picture depends on these
_REACH_M = 80.0  # farther points are not looked at
_CLOSE_M, _FAR_M = 12.0, 80.0  # shortest and longest side of a crop
_SIDE = 40.0  # side of a crop per length by which the place is off
_LEAST = (
    0.02  # weight of a point that the correction does not move closer: such points decide only where there are no others
)
_CELLS = 4  # cells along the side of a crop when its place is looked for

Points: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Crop:
    """A place before and after its correction.

    Args:
        title: what and where it is.
        text: size and direction of the correction.
        before, after: one (M, 2) [m] per pass or sweep, the earliest first, in the frame of the sensor there.
    """

    title: str
    text: str
    before: tuple[Points, ...]
    after: tuple[Points, ...]


def make_crops(sweeps: Sweeps, audit: Audit, settings: AuditConfig, count: int = WORST) -> tuple[Crop, ...]:
    """Returns the worst places, each where its correction shows the most.

    Args:
        sweeps: what was judged.
        audit: its judgement.
        settings: settings of the audit.
        count: how many crops at most.
    """
    return tuple(make_crop(sweeps, spot) for spot in find_worst_spots(sweeps, audit, settings, count))


def make_crop(sweeps: Sweeps, spot: Spot) -> Crop:
    """Returns one place, where its correction shows the most.

    Args:
        sweeps: what was judged.
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
    return Crop(
        spot.title,
        spot.text,
        tuple(p[are_inside(p, view)] for p in before),
        tuple(p[are_inside(p, view)] for p in after),
    )


def draw_crop(crop: Crop) -> tuple[bytes, bytes]:
    """Draws a crop before and after, on one extent; the earliest pass or sweep is blue, the last one orange."""
    shown = [points for points in (*crop.before, *crop.after) if len(points)]
    view = find_common_view(shown, (1.0, 1.0)) if shown else find_heaviest_square(np.empty((0, 2)), np.empty(0), _CLOSE_M)
    return _draw_dots(view, crop.before), _draw_dots(view, crop.after)


def find_heaviest_square(points: Points, weights: NDArray[np.float64], side: float) -> View:
    """Returns the square whose points weigh the most together.

    Args:
        points: (N, 2) [m].
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
    at = np.array(np.unravel_index(np.argmax(together), together.shape)) - _CELLS + low  # the square's middle
    x, y = (at * cell).tolist()
    return View(x - 0.5 * side, x + 0.5 * side, y - 0.5 * side, y + 0.5 * side)


def are_inside(points: Points, view: View) -> NDArray[np.bool_]:
    """Returns which of the points (N, 2) [m] a view shows."""
    x, y = points.T
    return np.asarray((x >= view.x0) & (x <= view.x1) & (y >= view.y0) & (y <= view.y1))


def measure_distances(points: Points, others: Points, most: float) -> NDArray[np.float64]:
    """Returns the distance from each of the points (N, 2) to the nearest of others (M, 2), cut off at `most` [m]."""
    distances, _ = cKDTree(others).query(points, distance_upper_bound=most)
    return np.asarray(np.minimum(distances, most))


def _bend(sweeps: Sweeps, spot: Spot) -> tuple[list[Points], list[Points]]:
    """Returns a window's points (M, 2), sweep by sweep, as they are and corrected."""
    begin, end = spot.stretches[0][0], spot.stretches[0][-1] + 1
    points, into = centre_window(sweeps, begin, end)
    mended = twist_points(points, into, spot.correction / (end - begin)).points
    cuts = sweeps.begins[begin + 1 : end] - sweeps.begins[begin]
    return np.split(points.points, cuts), np.split(mended, cuts)


def _move(sweeps: Sweeps, spot: Spot) -> tuple[list[Points], list[Points]]:
    """Returns the points (M, 2) of two stretches in the frame of the later one, as they are and with the later one moved."""
    earlier, later = (sweeps.local(part, spot.pose).points for part in spot.stretches)
    return [earlier, later], [earlier, se2.transform(spot.correction, later)]


def _draw_dots(view: View, passes: tuple[Points, ...]) -> bytes:
    from matplotlib.colors import to_rgb

    figure, axes = make_square(view)
    ends = np.array([to_rgb(BLUE), to_rgb(ORANGE)])
    for share, points in zip(np.linspace(0.0, 1.0, len(passes)), passes, strict=True):
        colour = tuple((1.0 - share) * ends[0] + share * ends[1])
        strength = 0.4 + 0.4 * abs(2.0 * share - 1.0)  # the first and the last are the farthest apart
        axes.plot(points[:, 0], points[:, 1], ".", color=colour, markersize=3.5, markeredgewidth=0, alpha=strength)
    return encode_png(figure)
