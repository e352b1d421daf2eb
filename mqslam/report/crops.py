"""Crops of a map before and after a correction, close enough to see what it mends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter
from scipy.spatial import cKDTree

from mqslam.audit.inflation import centre_window, twist_points
from mqslam.audit.judge import Audit
from mqslam.audit.revisits import Revisit, pick_passes
from mqslam.audit.sweeps import Sweeps
from mqslam.audit.windows import WindowAudit
from mqslam.config import AuditConfig
from mqslam.core import se2
from mqslam.report.canvas import BLUE, ORANGE, View, common_view, png, square
from mqslam.report.spots import WORST, Spot, worst_spots

_REACH_M = 80.0  # farther points are not looked at
_CLOSE, _FAR = 12.0, 80.0  # shortest and longest side of a crop [m]
_SIDE = 40.0  # side of a crop per what is off in it
_LEAST = 0.02  # what a point counts that gains nothing, so that where nothing shows the points decide
_CELLS = 4  # cells along the side of a crop when its place is looked for

Points = NDArray[np.float64]


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


def crops(sweeps: Sweeps, audit: Audit, settings: AuditConfig, count: int = WORST) -> tuple[Crop, ...]:
    """The worst places, each where the correction shows the most.

    Args:
        sweeps: what was judged.
        audit: what came of it.
        settings: it was judged by.
        count: how many at most.
    """
    return tuple(crop_of(sweeps, spot, settings) for spot in worst_spots(sweeps, audit, count))


def crop_pictures(crop: Crop) -> tuple[bytes, bytes]:
    """A crop before and after, on one extent; the earliest pass or sweep is blue, the last one orange."""
    shown = [points for points in (*crop.before, *crop.after) if len(points)]
    view = common_view(shown, (1.0, 1.0)) if shown else where_it_shows(np.empty((0, 2)), np.empty(0), _CLOSE)
    return _dots(view, crop.before), _dots(view, crop.after)


def where_it_shows(points: Points, weights: NDArray[np.float64], side: float) -> View:
    """The square of some side [m] whose points (N, 2) [m] weigh (N,) the most together."""
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


def inside(points: Points, view: View) -> NDArray[np.bool_]:
    """Which of the points (N, 2) [m] the view shows."""
    x, y = points.T
    return np.asarray((x >= view.x0) & (x <= view.x1) & (y >= view.y0) & (y <= view.y1))


def crop_of(sweeps: Sweeps, spot: Spot, settings: AuditConfig) -> Crop:
    """One place, where its correction shows the most."""
    if isinstance(spot.found, WindowAudit):
        before, after = _window(sweeps, spot.found)
    else:
        before, after = _revisit(sweeps, spot.found.revisit, settings)
    half = len(before) // 2
    (a0, b0), (a1, b1) = ((np.concatenate(p[:half]), np.concatenate(p[half:])) for p in (before, after))
    near = np.abs(b1).max(axis=1, initial=0.0) <= _REACH_M
    most = max(2.0 * spot.off_m, 0.2)
    gained = np.full(np.count_nonzero(near), _LEAST * most)
    if len(a0):
        gained += distances(b0[near], a0, most) - distances(b1[near], a1, most)
    view = where_it_shows(b1[near], gained, float(np.clip(_SIDE * spot.off_m, _CLOSE, _FAR)))
    return Crop(
        spot.title,
        spot.text,
        tuple(p[inside(p, view)] for p in before),
        tuple(p[inside(p, view)] for p in after),
    )


def _window(sweeps: Sweeps, window: WindowAudit) -> tuple[list[Points], list[Points]]:
    """A window's points (M, 2), sweep by sweep, as they are and corrected."""
    points, into = centre_window(sweeps, window.begin, window.end)
    mended = twist_points(points, into, window.bend.correction / (window.end - window.begin)).points
    cuts = sweeps.begins[window.begin + 1 : window.end] - sweeps.begins[window.begin]
    return np.split(points.points, cuts), np.split(mended, cuts)


def _revisit(sweeps: Sweeps, found: Revisit, settings: AuditConfig) -> tuple[list[Points], list[Points]]:
    """The points (M, 2) of two passes in the frame of the later one, as they are and with the later one moved."""
    passes = pick_passes(sweeps, found.earlier, found.later, settings)
    earlier, later = (sweeps.local(part, sweeps.poses[found.later]).points for part in passes)
    return [earlier, later], [earlier, se2.transform(found.offset, later)]


def distances(points: Points, others: Points, most: float) -> NDArray[np.float64]:
    """From every point (N, 2) to the nearest of some others (M, 2), cut off at `most` [m]."""
    found, _ = cKDTree(others).query(points, distance_upper_bound=most)
    return np.asarray(np.minimum(found, most))


def _dots(view: View, passes: tuple[Points, ...]) -> bytes:
    from matplotlib.colors import to_rgb

    figure, axes = square(view)
    ends = np.array([to_rgb(BLUE), to_rgb(ORANGE)])
    for share, points in zip(np.linspace(0.0, 1.0, len(passes)), passes, strict=True):
        colour = tuple((1.0 - share) * ends[0] + share * ends[1])
        strength = 0.4 + 0.4 * abs(2.0 * share - 1.0)  # the ends are the farthest apart
        axes.plot(points[:, 0], points[:, 1], ".", color=colour, markersize=3.5, markeredgewidth=0, alpha=strength)
    return png(figure)
