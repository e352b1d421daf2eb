"""The heat map of an audit: the map in grey, the path coloured by its windows' inflation, torn revisits as red links."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mqslam.auditing.judge import Audit
from mqslam.auditing.revisits import RevisitAudit
from mqslam.auditing.sizes import TORN_INFLATION
from mqslam.auditing.sweeps import Sweeps
from mqslam.report.canvas import (
    GREY,
    INK,
    MAP_SHAPE,
    OUTERMOST,
    RED,
    Points,
    View,
    encode_png,
    find_common_view,
    lay_ink,
    make_halo,
    make_world,
)
from mqslam.report.words import format_length

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

# the looks of the figure; no result depends on them
_REACH = 100.0  # factor of inflation that the colours show below the threshold, and above it
_COLOURS: Final = ((0.0, "#123f86"), (0.5, "#6db3ea"), (0.5, "#f6bd3c"), (0.75, "#b8640a"), (1.0, "#432104"))
_LABELS = 6  # torn revisits whose offset is written beside them
_LABELS_APART = 0.17  # least distance between two such offsets, per width of the picture
_STRIP_IN = 0.62  # height of the strip above the map


def draw_heat_map(sweeps: Sweeps, audit: Audit, *, opaque: bool = True) -> bytes:
    """Draws an audited map as a PNG file.

    Args:
        sweeps: what was judged.
        audit: the windows and revisits, judged.
        opaque: whether it is drawn on white, to be looked at by itself, rather than on a transparent ground, for a page.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, LogNorm

    path = sweeps.poses[:, :2]
    view = find_common_view([sweeps.points, path], MAP_SHAPE, OUTERMOST)
    figure, axes = make_world(view, _STRIP_IN)
    lay_ink(view, [(axes, sweeps.points, GREY)])
    axes.plot(*path.T, color="white", linewidth=4.5, solid_joinstyle="round")
    axes.plot(*path.T, color=GREY, linewidth=1.0)
    # blue up to the threshold, orange to brown beyond it, lighter towards it
    shades = LinearSegmentedColormap.from_list("inflation", list(_COLOURS), 512)
    colours = ScalarMappable(LogNorm(TORN_INFLATION / _REACH, TORN_INFLATION * _REACH), shades)
    decided = [window for window in audit.windows if window.undecided is None]
    for window in sorted(decided, key=lambda w: w.bend.inflation):  # the worst on top where the path crosses itself
        part, width = path[window.begin : window.end + 1], 5.0 if window.torn else 2.0
        (colour,) = colours.to_rgba(np.array([window.bend.inflation]))
        axes.plot(*part.T, color=colour, linewidth=width, solid_capstyle="butt")
    torn = [r for r in audit.revisits if r.torn]
    _draw_links(axes, path, torn, view)
    _draw_colour_strip(figure, axes, colours, len(torn))
    return encode_png(figure, opaque)


def _draw_links(axes: Axes, path: Points, torn: Sequence[RevisitAudit], view: View) -> None:
    """Draws a line between the two passes of torn revisits, and beside the worst of them how far they are off."""
    for r in torn:
        axes.plot(*path[[r.revisit.earlier, r.revisit.later]].T, "-o", color=RED, linewidth=1.0, markersize=2.5, mew=0)
    apart_m = _LABELS_APART * (view.x1 - view.x0)
    written: list[Points] = []
    for revisit in sorted((r.revisit for r in torn), key=lambda revisit: -revisit.distance_m):
        at = path[[revisit.earlier, revisit.later]].mean(axis=0)
        if len(written) == _LABELS or any(np.hypot(*(at - other)) <= apart_m for other in written):
            continue
        written.append(at)
        offset, side = ((-7, 7), "right") if at[0] > view.x1 - apart_m else ((7, 7), "left")
        style: dict[str, Any] = {"color": RED, "fontsize": 10, "fontweight": "bold", "zorder": 6}
        label = format_length(revisit.distance_m)
        text = axes.annotate(label, at, offset, textcoords="offset points", ha=side, **style)
        text.set_path_effects(make_halo())


def _draw_colour_strip(figure: Figure, axes: Axes, colours: ScalarMappable, torn: int) -> None:
    """Draws the key of the colours and the links above the map."""
    box, height = axes.get_position(), figure.get_figheight()
    strip = figure.add_axes((box.x0, box.y1 + 0.22 / height, 0.56 * box.width, 0.14 / height))
    bar = figure.colorbar(colours, cax=strip, orientation="horizontal", extend="both")
    bar.ax.xaxis.set_ticks_position("top")
    bar.set_ticks([1.0, 10.0, 100.0, 1000.0], labels=["1", "10", "100", "1000"])
    bar.minorticks_off()
    bar.ax.tick_params(labelsize=9, colors=INK, length=2, pad=1)
    bar.outline.set_visible(False)
    bar.ax.axvline(TORN_INFLATION, color=INK, linewidth=1.6)
    label = f"no chance beyond {TORN_INFLATION:.1f}; thick: torn"
    style: dict[str, Any] = {
        "ha": "center",
        "va": "top",
        "fontsize": 9,
        "color": INK,
        "transform": bar.ax.get_xaxis_transform(),
    }
    bar.ax.text(TORN_INFLATION, -0.25, label, **style)
    beside = box.x0 + 0.6 * box.width
    figure.text(beside, box.y1 + 0.29 / height, "inflation of the windows", fontsize=9, color=INK, va="center")
    if torn:
        meaning = f"●–● torn revisits ({torn}), how far off"
        figure.text(beside, box.y1 + 0.12 / height, meaning, fontsize=9, color=RED, va="center")
