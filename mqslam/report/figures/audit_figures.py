"""Figures of an audit's page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from mqslam.auditing.judge import Audit
from mqslam.auditing.revisits import RevisitAudit
from mqslam.auditing.sizes import TORN_INFLATION
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.windows.windows import WindowAudit
from mqslam.config import AuditConfig
from mqslam.report.figures.canvas import (
    BLUE,
    GREY,
    INK,
    MAP_SHAPE,
    OUTERMOST,
    RED,
    View,
    count_points,
    encode_png,
    find_common_view,
    lay_ink,
    make_chart,
    make_halo,
    make_world,
    put_legend_strip,
    use_plain_log,
)
from mqslam.report.figures.svg import encode_svg
from mqslam.report.formatting import format_length

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

EXPECTED: Final = float(chi2.median(3))  # median inflation where the trajectory is right: three parameters are corrected
# the looks of the figures; no result depends on them
_DECADES = 2.0  # powers of ten of inflation that the colours show below the threshold, and above it
_FINE = ("#123f86", "#6db3ea")  # colours up to the threshold
_TORN = ("#f6bd3c", "#b8640a", "#432104")  # colours beyond it
_LABELS = 6  # torn revisits whose offset is written beside them
_LABELS_APART = 0.17  # least distance between two such offsets, per width of the picture
_STRIP_IN = 0.62  # height of the strip above the map
_LEAST_INFLATION, _LEAST_M = 1e-2, 1e-3  # smaller values are drawn as these on a logarithmic axis


def draw_heat_map(sweeps: Sweeps, audit: Audit, *, opaque: bool = True) -> bytes:
    """Draws the map in grey, the trajectory in the colours of its windows' inflation, and torn revisits as red links.

    Args:
        sweeps: what was judged.
        audit: the windows and revisits, judged.
        opaque: whether it is drawn on white, to be looked at by itself, rather than on a transparent ground, for a page.
    """
    view = find_common_view([sweeps.points, sweeps.poses[:, :2]], MAP_SHAPE, OUTERMOST)
    figure, axes = make_world(view, _STRIP_IN)
    (counts,), well_seen = count_points(axes, view, [sweeps.points])
    lay_ink(axes, view, counts, well_seen, GREY)
    axes.plot(*sweeps.poses[:, :2].T, color="white", linewidth=4.5, solid_joinstyle="round")
    axes.plot(*sweeps.poses[:, :2].T, color=GREY, linewidth=1.0)
    colours = _make_colours(TORN_INFLATION)
    decided = [window for window in audit.windows if window.undecided is None]
    windows = sorted(decided, key=_inflation_of)  # the worst on top where the path crosses itself
    for window, colour in zip(windows, colours.to_rgba(np.array([_inflation_of(w) for w in windows])), strict=True):
        axes.plot(
            *sweeps.poses[window.begin : window.end + 1, :2].T,
            color=colour,
            linewidth=5.0 if window.torn else 2.0,
            solid_capstyle="butt",
        )
    torn = [r for r in audit.revisits if r.torn]
    _draw_links(axes, sweeps, torn, view)
    _draw_colour_strip(figure, axes, colours, TORN_INFLATION, len(torn))
    return encode_png(figure, opaque)


def draw_inflation(audit: Audit) -> bytes:
    """Draws the inflation of every window over time."""
    figure, axes = make_chart("inflation", above_in=0.28)
    time = np.array([0.5 * (w.t0 + w.t1) for w in audit.windows])
    inflation = np.array([_inflation_of(w) for w in audit.windows])
    torn = np.array([w.torn for w in audit.windows])
    undecided = np.array([w.undecided is not None for w in audit.windows])
    use_plain_log(axes, "y")
    drawn = np.maximum(inflation, _LEAST_INFLATION)
    if undecided.any():
        label = f"undecided ({undecided.sum()})"
        axes.plot(time[undecided], drawn[undecided], "o", color=GREY, markersize=4, fillstyle="none", label=label)
    _draw_marks(axes, time[~undecided], drawn[~undecided], torn[~undecided], "window")
    axes.axhline(TORN_INFLATION, color=RED, linewidth=1.2, label=f"threshold {TORN_INFLATION:.1f}")
    axes.axhline(EXPECTED, color=INK, linewidth=1.2, linestyle="--", label=f"expected median {EXPECTED:.2f}")
    put_legend_strip(axes, 5)
    return encode_svg(figure)


def draw_revisits(sweeps: Sweeps, audit: Audit, settings: AuditConfig) -> bytes:
    """Draws how far the two passes of every revisit are apart, over the path."""
    figure, axes = make_chart("offset [m]", "path [m]", above_in=0.28)
    sure = [r for r in audit.revisits if r.revisit.sure]
    unsure = [r for r in audit.revisits if not r.revisit.sure]
    use_plain_log(axes, "y")
    x, y = _offsets_over_path(sweeps, unsure)
    if len(x):
        axes.plot(x, y, "o", color=GREY, markersize=4, fillstyle="none", label=f"not sure ({len(x)})")
    _draw_marks(axes, *_offsets_over_path(sweeps, sure), np.array([r.torn for r in sure], dtype=np.bool_), "revisit")
    axes.axhline(settings.torn_m, color=RED, linewidth=1.2, label=f"tolerance {settings.torn_m:g} m")
    axes.set_xlim(0.0, float(sweeps.travelled[-1]))
    put_legend_strip(axes, 4)
    return encode_svg(figure)


def _make_colours(limit: float) -> ScalarMappable:
    """Returns logarithmic colours of inflation: blue up to the limit, orange to brown beyond it, lighter towards it."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, LogNorm

    stops = [(0.0, _FINE[0]), (0.5, _FINE[1]), (0.5, _TORN[0]), (0.75, _TORN[1]), (1.0, _TORN[2])]
    reach = 10.0**_DECADES
    return ScalarMappable(LogNorm(limit / reach, limit * reach), LinearSegmentedColormap.from_list("inflation", stops, 512))


def _draw_links(axes: Axes, sweeps: Sweeps, torn: list[RevisitAudit], view: View) -> None:
    """Draws a line between the two passes of torn revisits, and beside the worst of them how far they are off."""
    ends = [sweeps.poses[[r.revisit.earlier, r.revisit.later], :2] for r in torn]
    for line in ends:
        axes.plot(*line.T, "-o", color=RED, linewidth=1.0, markersize=2.5, markeredgewidth=0)
    apart_m = _LABELS_APART * (view.x1 - view.x0)
    written: list[NDArray[np.float64]] = []
    for k in sorted(range(len(torn)), key=lambda k: -torn[k].revisit.distance_m):
        at = ends[k].mean(axis=0)
        if len(written) < _LABELS and all(np.hypot(*(at - other)) > apart_m for other in written):
            written.append(at)
            leftward = at[0] > view.x1 - apart_m
            text = axes.annotate(
                format_length(torn[k].revisit.distance_m),
                at,
                (-7 if leftward else 7, 7),
                textcoords="offset points",
                ha="right" if leftward else "left",
                color=RED,
                fontsize=10,
                fontweight="bold",
                zorder=6,
            )
            text.set_path_effects(make_halo())


def _draw_colour_strip(figure: Figure, axes: Axes, colours: ScalarMappable, limit: float, torn: int) -> None:
    """Draws the key of the colours and the links above the map."""
    box, height = axes.get_position(), figure.get_figheight()
    strip = figure.add_axes((box.x0, box.y1 + 0.22 / height, 0.56 * box.width, 0.14 / height))
    bar = figure.colorbar(colours, cax=strip, orientation="horizontal", extend="both")
    bar.ax.xaxis.set_ticks_position("top")
    bar.set_ticks([1.0, 10.0, 100.0, 1000.0], labels=["1", "10", "100", "1000"])
    bar.minorticks_off()
    bar.ax.tick_params(labelsize=9, colors=INK, length=2, pad=1)
    bar.outline.set_visible(False)
    bar.ax.axvline(limit, color=INK, linewidth=1.6)
    bar.ax.text(
        limit,
        -0.25,
        f"no chance beyond {limit:.1f}; thick: torn",
        ha="center",
        va="top",
        fontsize=9,
        color=INK,
        transform=bar.ax.get_xaxis_transform(),
    )
    beside = box.x0 + 0.6 * box.width
    figure.text(beside, box.y1 + 0.29 / height, "inflation of the windows", fontsize=9, color=INK, va="center")
    if torn:
        meaning = f"●–● torn revisits ({torn}), how far off"
        figure.text(beside, box.y1 + 0.12 / height, meaning, fontsize=9, color=RED, va="center")


def _offsets_over_path(sweeps: Sweeps, revisits: list[RevisitAudit]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns the path [m] up to the later pass of every revisit, and the revisit's offset [m]."""
    path = np.array([sweeps.travelled[r.revisit.later] for r in revisits])
    return path, np.maximum([r.revisit.distance_m for r in revisits], _LEAST_M)


def _draw_marks(axes: Axes, x: NDArray[np.float64], y: NDArray[np.float64], torn: NDArray[np.bool_], what: str) -> None:
    axes.plot(x[~torn], y[~torn], "o", color=BLUE, markersize=3.5, markeredgewidth=0, label=f"{what}s ({np.sum(~torn)})")
    if torn.any():
        axes.plot(x[torn], y[torn], "^", color=RED, markersize=4.5, markeredgewidth=0, label=f"torn ({np.sum(torn)})")


def _inflation_of(window: WindowAudit) -> float:
    return window.bend.inflation
