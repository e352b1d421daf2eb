"""Draws the heat map: the map in grey, the path in the colours of its windows' inflation, other torn places in red.

Other torn places are jumps, spans, sums of spans and revisits, which `mqslam.results.audit_results` explains.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mqslam.auditing.judge import Audit
from mqslam.auditing.sizes import TORN_INFLATION
from mqslam.auditing.spans.sums import find_bends
from mqslam.auditing.windows.windows import WindowAudit
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
_REACH = 100.0  # the colours reach from the threshold divided by this to the threshold times this
_COLOURS: Final = ((0.0, "#123f86"), (0.5, "#6db3ea"), (0.5, "#f6bd3c"), (0.75, "#b8640a"), (1.0, "#432104"))
_LABELS = 6  # most torn places that are labelled with the size of their offset
_LABELS_APART = 0.17  # least distance between two such labels, in widths of the picture
_STRIP_IN = 0.62  # height of the strip above the map


@dataclass(frozen=True, slots=True)
class _TornPlace:
    """A torn place between two scans.

    Args:
        earlier, later: numbers of the scans in the path.
        off_m: how far the later scan is off relative to the earlier scan [m].
        is_stretch: whether the path between the two scans is torn; otherwise the scans belong to two passes of one place.
    """

    earlier: int
    later: int
    off_m: float
    is_stretch: bool = True


def draw_heat_map(points: Points, path: Points, audit: Audit | None, *, opaque: bool = True) -> bytes:
    """Draws the heat map of an audit as a PNG file.

    Args:
        points: (N, 2) points x, y of the map [m].
        path: (K, 2) positions x, y of the scans that were judged, in the frame of the points [m].
        audit: judgement of the map; None if the map was not judged.
        opaque: whether the background is white, for a picture outside a page. Otherwise it is transparent, and the picture
            has 256 colours, which take a third of the bytes.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, LogNorm

    view = find_common_view([points, path], MAP_SHAPE, OUTERMOST)
    figure, axes = make_world(view, _STRIP_IN)
    lay_ink(view, [(axes, points, GREY)])
    axes.plot(*path.T, color="white", linewidth=4.5, solid_joinstyle="round")
    axes.plot(*path.T, color=GREY, linewidth=1.0)
    # blue below the threshold, orange to brown above it; the nearer to the threshold, the lighter
    shades = LinearSegmentedColormap.from_list("inflation", list(_COLOURS), 512)
    colours = ScalarMappable(LogNorm(TORN_INFLATION / _REACH, TORN_INFLATION * _REACH), shades)
    torn = [] if audit is None else _list_torn(audit)
    _draw_torn(axes, path, torn, view)
    decided = [] if audit is None else [window for window in audit.windows if window.undecided is None]
    for window in sorted(decided, key=lambda w: w.bend.inflation):  # the worst on top where the path crosses itself
        part, width = path[window.begin : window.end + 1], 5.0 if window.torn else 2.0
        (colour,) = colours.to_rgba(np.array([window.bend.inflation]))
        axes.plot(*part.T, color=colour, linewidth=width, solid_capstyle="butt")
    if audit is not None:
        _draw_colour_strip(figure, axes, colours, len(torn))
    picture = encode_png(figure, opaque)
    return picture if opaque else _reduce_colours(picture)


def _reduce_colours(picture: bytes) -> bytes:
    """Converts the content of a PNG file to 256 colours."""
    from PIL import Image

    file = io.BytesIO()
    Image.open(io.BytesIO(picture)).quantize(256, Image.Quantize.FASTOCTREE).save(file, "PNG", optimize=True)
    return file.getvalue()


def explain_heat_map(windows: Sequence[WindowAudit]) -> str:
    """Returns the caption of a heat map whose path has the colours of the inflation of these windows."""
    undecided = any(window.undecided is not None for window in windows)
    return (
        "every return in grey, the path in the colour of its windows' inflation: blue up to the threshold "
        f"{TORN_INFLATION:.1f}, orange beyond it, thick where torn; other torn places in red, with the size of their offset"
        + ("; grey where nothing could be decided" if undecided else "")
    )


def _list_torn(audit: Audit) -> list[_TornPlace]:
    """Returns the jumps and the torn spans, sums of spans and revisits of an audit."""
    jumps = [jump.registration for jump in audit.jumps]
    spans = [(span.registration, span.distance_m) for span in audit.spans if span.torn]
    revisits = [(one.registration, one.distance_m) for one in audit.revisits if one.torn]
    return [
        *(_TornPlace(jump.earlier, jump.later, jump.size_m) for jump in jumps),
        *(_TornPlace(span.earlier, span.later, off_m) for span, off_m in spans),
        *(_TornPlace(one.earlier, one.later, one.distance_m) for one in find_bends(audit.sums)),
        *(_TornPlace(one.earlier, one.later, off_m, is_stretch=False) for one, off_m in revisits),
    ]


def _draw_torn(axes: Axes, path: Points, torn: Sequence[_TornPlace], view: View) -> None:
    """Draws torn stretches along the path (K, 2) [m] and lines between torn passes, and labels the largest offsets."""
    for place in torn:
        if place.is_stretch:
            part = path[place.earlier : place.later + 1]
            axes.plot(*part.T, color=RED, linewidth=11.0, alpha=0.35, solid_capstyle="round")
        else:
            axes.plot(*path[[place.earlier, place.later]].T, "-o", color=RED, linewidth=1.0, markersize=2.5, mew=0)
    apart_m = _LABELS_APART * (view.x1 - view.x0)
    written: list[Points] = []
    for place in sorted(torn, key=lambda place: -place.off_m):
        at = path[[place.earlier, place.later]].mean(axis=0)
        if len(written) == _LABELS or any(np.hypot(*(at - other)) <= apart_m for other in written):
            continue
        written.append(at)
        offset, side = ((-7, 7), "right") if at[0] > view.x1 - apart_m else ((7, 7), "left")
        style: dict[str, Any] = {"color": RED, "fontsize": 10, "fontweight": "bold", "zorder": 6}
        text = axes.annotate(format_length(place.off_m), at, offset, textcoords="offset points", ha=side, **style)
        text.set_path_effects(make_halo())


def _draw_colour_strip(figure: Figure, axes: Axes, colours: ScalarMappable, torn: int) -> None:
    """Draws a strip above the map that explains the colours, and writes next to it how many other places are torn."""
    box, height = axes.get_position(), figure.get_figheight()
    strip = figure.add_axes((box.x0, box.y1 + 0.22 / height, 0.56 * box.width, 0.14 / height))
    bar = figure.colorbar(colours, cax=strip, orientation="horizontal", extend="both")
    bar.ax.xaxis.set_ticks_position("top")
    bar.set_ticks([1.0, 10.0, 100.0, 1000.0], labels=["1", "10", "100", "1000"])
    bar.minorticks_off()
    bar.ax.tick_params(labelsize=9, colors=INK, length=2, pad=1)
    bar.outline.set_visible(False)
    bar.ax.axvline(TORN_INFLATION, color=INK, linewidth=1.6)
    label = f"above {TORN_INFLATION:.1f}: more than chance; thick line: torn"
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
        meaning = f"red: other torn places ({torn})"
        figure.text(beside, box.y1 + 0.12 / height, meaning, fontsize=9, color=RED, va="center")
