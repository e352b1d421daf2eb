"""Figures of a localisation's page: where the scans lie in the map, and how sure that is."""

from __future__ import annotations

from typing import Final

import numpy as np

from mqslam.core.keyframes import Keyframes
from mqslam.localisation.localised import Localised, PlaceStatus
from mqslam.mapping.keyframing import render_keyframes
from mqslam.report.figures.canvas import (
    BLUE,
    MAP_SHAPE,
    ORANGE,
    OUTERMOST,
    RED,
    VIOLET,
    count_points,
    encode_png,
    find_common_view,
    lay_ink,
    make_chart,
    make_world,
    put_legend_above,
)
from mqslam.report.figures.svg import encode_svg

# the looks of the figures; no result depends on them
_LOOKS: Final = {
    PlaceStatus.CONVERGED: (BLUE, "."),
    PlaceStatus.DEGENERATE: (ORANGE, "s"),
    PlaceStatus.LOST: (RED, "^"),
    PlaceStatus.OUTSIDE: (VIOLET, "x"),
}


def draw_scans_in_map(keyframes: Keyframes, localised: Localised) -> bytes:
    """Draws a map, and the scans that were found in it by their status."""
    points, places = render_keyframes(keyframes).points, localised.poses[:, :2]
    view = find_common_view([points, places], MAP_SHAPE, OUTERMOST)
    figure, axes = make_world(view)
    (counts,), well_seen = count_points(axes, view, [points])
    lay_ink(axes, view, counts, well_seen)
    for status, (colour, marker) in _LOOKS.items():
        chosen = np.array([one is status for one in localised.statuses], dtype=np.bool_)
        if chosen.any():
            axes.plot(*places[chosen].T, marker, color=colour, markersize=3.0, label=status.value)
    put_legend_above(axes)
    return encode_png(figure)


def draw_surety(localised: Localised) -> bytes:
    """Draws the standard deviation of each pose on the map over time."""
    seconds = 1e-6 * (localised.stamps_us - localised.stamps_us[0])
    sigmas = np.sqrt(np.einsum("nii->ni", localised.covariances))
    figure, axes = make_chart("standard deviation [m]")
    for column, (name, colour) in enumerate((("along", BLUE), ("across", ORANGE))):
        for chosen, style in ((localised.on_map, "-"), (~localised.on_map, ":")):
            shown = np.where(chosen, sigmas[:, column], np.nan)
            axes.plot(seconds, shown, style, color=colour, linewidth=1.0, label=name if style == "-" else None)
    if localised.on_map.any() and not localised.on_map.all():  # predictions are unsure by metres, poses by millimetres
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0.0)
    put_legend_above(axes)
    return encode_svg(figure)


def draw_overlap(localised: Localised) -> bytes:
    """Draws over time what share of each scan's returns lies on the map."""
    seconds = 1e-6 * (localised.stamps_us - localised.stamps_us[0])
    figure, axes = make_chart("matched share [%]")
    axes.plot(seconds, 100.0 * localised.matched, color=BLUE, linewidth=1.0)
    axes.set_ylim(0.0, 100.0)
    return encode_svg(figure)
