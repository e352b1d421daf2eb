"""Figures of a merge's page: each recording has its own colour in all of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.merging.changes import Change
from mqslam.merging.map_merge import Merged
from mqslam.report.figures.canvas import (
    BLUE,
    GREEN,
    GREY,
    MAP_SHAPE,
    ORANGE,
    OUTERMOST,
    RED,
    VIOLET,
    View,
    count_points,
    encode_png,
    find_common_view,
    lay_ink,
    make_square,
    make_world,
)

# the looks of the figures; no result depends on them
_COLOURS: Final = (BLUE, ORANGE, GREEN, VIOLET)
COLOUR_NAMES: Final = ("blue", "orange", "green", "violet")
_SIDE_M: Final = 40.0  # side of the picture of a change


def split_points(merged: Merged) -> list[NDArray[np.float64]]:
    """Returns the points (N, 2) [m] of each recording in the merged map."""
    keyframes = merged.kept.keyframes
    owner = np.repeat(keyframes.origins, np.diff(keyframes.rows, axis=1)[:, 0])
    return [merged.map.points[owner == n] for n in range(len(keyframes.recordings))]


def draw_recordings(points: Sequence[NDArray[np.float64]], changes: Sequence[Change]) -> bytes:
    """Draws the maps of all recordings over each other, with a circle around every change.

    Args:
        points: (N, 2) of each recording [m].
        changes: between them.
    """
    view = find_common_view(list(points), MAP_SHAPE, OUTERMOST)
    figure, axes = make_world(view)
    counts, well_seen = count_points(axes, view, list(points))
    for n, count in enumerate(counts):
        lay_ink(axes, view, count, well_seen, _COLOURS[n % len(_COLOURS)])
    if changes:
        places = np.array([change.place for change in changes])
        axes.plot(places[:, 0], places[:, 1], "o", markerfacecolor="none", markeredgecolor=RED, markersize=5)
    return encode_png(figure)


def draw_links(merged: Merged) -> bytes:
    """Draws the trajectories of all recordings, and the links between them."""
    tracks, poses = merged.trajectories, merged.kept.keyframes.poses
    view = find_common_view([track.poses[:, :2] for track in tracks], MAP_SHAPE)
    figure, axes = make_world(view)
    for link in merged.links.loops:
        ends = poses[[link.earlier, link.later]]
        axes.plot(ends[:, 0], ends[:, 1], color=GREY, linewidth=1.6)
    for n, track in enumerate(tracks):
        axes.plot(track.poses[:, 0], track.poses[:, 1], color=_COLOURS[n % len(_COLOURS)], linewidth=1.0)
    return encode_png(figure)


def draw_change(points: NDArray[np.float64], change: Change, recording: int) -> bytes:
    """Draws the surroundings of a change in one recording.

    Args:
        points: (N, 2) of the recording [m].
        change: the change.
        recording: number of the recording.
    """
    x, y = change.place
    half = 0.5 * max(_SIDE_M, 2.0 * float(change.size_m.max()))
    view = View(x - half, x + half, y - half, y + half)
    figure, axes = make_square(view)
    counts, well_seen = count_points(axes, view, [points])
    lay_ink(axes, view, counts[0], well_seen, _COLOURS[recording % len(_COLOURS)])
    low = change.place - 0.5 * change.size_m - 1.0
    wide, high = change.size_m + 2.0
    axes.plot(low[0] + np.array([0, wide, wide, 0, 0]), low[1] + np.array([0, 0, high, high, 0]), color=RED, linewidth=1.5)
    return encode_png(figure)
