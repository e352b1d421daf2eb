"""Figures of a comparison's page: every row has its own colour and line style in all of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from mqslam.auditing.sizes import TORN_INFLATION
from mqslam.auditing.windows.windows import WindowAudit
from mqslam.comparison.judgement import JudgedRow, Place
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.evaluation import align_positions
from mqslam.report.figures.audit_figures import EXPECTED
from mqslam.report.figures.canvas import (
    INK,
    PATH_SHAPE,
    RED,
    encode_png,
    find_common_view,
    make_chart,
    make_halo,
    make_square,
    make_world,
    put_legend_strip,
    use_plain_log,
)
from mqslam.report.figures.crops import are_inside, find_heaviest_square, measure_distances
from mqslam.report.figures.svg import encode_svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# the looks of the figures; no result depends on them
_COLOURS = ("#0b5fb0", "#d55e00", "#00886a", "#a8327e", "#7a5c00", "#3aa5dd")
_STYLES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (6, 1.5, 1, 1.5, 1, 1.5)))
TRUTH_COLOUR = "#9aa3af"
_COUNT = " (999)"  # room for the count that may follow a name in a legend
_LINE_IN = 0.19  # height of a line of a legend
_LETTER_IN, _KEY_IN, _ACROSS_IN = 0.075, 0.5, 5.7  # width of a letter, of the line beside a name, and of the whole legend
_MEDIAN_OF = 15  # windows of the running median
_CLOSE_M, _FAR_M = 20.0, 100.0  # shortest and longest side of a crop
_SIDE = 25.0  # side of a crop per length by which the rows are apart
_MOST_M = 1.0  # largest weight of a point when the place of a crop is looked for
_LEAST_INFLATION, _LEAST_M = 1e-2, 1e-3  # smaller values are drawn as these on a logarithmic axis


def draw_overlay(rows: Sequence[JudgedRow], truth: Trajectory | None, *, opaque: bool = True) -> bytes:
    """Draws all trajectories over each other.

    Args:
        rows: the rows that ran.
        truth: ground truth, on which each is laid by the best rigid motion; without it all start from one pose.
        opaque: whether it is drawn on white, to be looked at by itself, rather than on a transparent ground, for a page.
    """
    tracks = {row.row.name: row.row.trajectory for row in rows if row.row.trajectory is not None}
    names = list(tracks)
    motions, shown = find_common_frame(list(tracks.values()), truth)
    paths = [se2.compose(m, t.poses)[:, :2] for m, t in zip(motions, tracks.values(), strict=True)]
    entries = names if shown is None else ["ground truth", *names]
    drawn = [*paths, *([] if shown is None else [shown])]
    figure, axes = make_world(find_common_view(drawn or [np.zeros((1, 2))], PATH_SHAPE), _measure_legend(entries)[1])
    if shown is not None:
        axes.plot(*shown.T, color=TRUTH_COLOUR, linewidth=5, alpha=0.6, solid_joinstyle="round", label="ground truth")
    for k, (name, path) in enumerate(zip(names, paths, strict=True)):
        axes.plot(*path.T, label=_escape(name), linewidth=1.6, **style_of(k))
    _put_legend(axes, entries)
    return encode_png(figure, opaque)


def smooth_inflation(windows: Sequence[WindowAudit]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns the middles (W,) [s] of windows and the running median (W,) of their inflation."""
    times = np.array([0.5 * (w.t0 + w.t1) for w in windows])
    inflation = np.maximum([w.bend.inflation for w in windows], _LEAST_INFLATION)
    return times, np.asarray(median_filter(inflation, min(_MEDIAN_OF, max(len(inflation), 1)), mode="nearest"))


def draw_inflation(rows: Sequence[JudgedRow], windows: Sequence[Sequence[WindowAudit]]) -> bytes:
    """Draws the running median of the inflation of all rows' windows over time.

    Args:
        rows: the rows that ran.
        windows: of each row, those that are drawn.
    """
    figure, axes = _make_row_chart(rows, "inflation")
    use_plain_log(axes, "y")
    for k, (row, shown) in enumerate(zip(rows, windows, strict=True)):
        if shown:
            axes.plot(*smooth_inflation(shown), label=_escape(row.row.name), linewidth=1.6, **style_of(k))
    levels = ((EXPECTED, f"expected {EXPECTED:.2f}", INK), (TORN_INFLATION, f"threshold {TORN_INFLATION:.1f}", RED))
    for height, name, colour in levels:
        axes.axhline(height, color=colour, linewidth=1.0, alpha=0.6)
        text = axes.text(
            0.995, height, name, transform=axes.get_yaxis_transform(), ha="right", va="bottom", fontsize=9, color=colour
        )
        text.set_path_effects(make_halo())
    _put_legend(axes, [row.row.name + _COUNT for row in rows])
    return encode_svg(figure)


def draw_revisits(rows: Sequence[JudgedRow]) -> bytes:
    """Draws which share of every row's sure revisits is off by less than a length."""
    figure, axes = _make_row_chart(rows, "revisits [%]", "offset less than [m]")
    use_plain_log(axes, "x")
    for k, row in enumerate(rows):
        offsets = np.sort([r.revisit.distance_m for r in row.audit.revisits if r.revisit.sure])
        if len(offsets):
            reached = 100.0 * np.arange(1, len(offsets) + 1) / len(offsets)
            label = f"{_escape(row.row.name)} ({len(offsets)})"
            axes.step(np.maximum(offsets, _LEAST_M), reached, where="post", label=label, linewidth=1.6, **style_of(k))
    axes.set_ylim(0.0, 102.0)
    _put_legend(axes, [row.row.name + _COUNT for row in rows])
    return encode_svg(figure)


def draw_place(rows: Sequence[JudgedRow], number: int, place: Place) -> tuple[bytes, ...]:
    """Draws one place under every row, on one extent, where the rows differ most.

    Args:
        rows: the rows that ran.
        number: number of the place among their crops.
        place: the place.
    """
    crops = [row.crops[number] for row in rows]
    others = [*crops[1:], *crops[:1]]
    weights = [measure_distances(a, b, _MOST_M) if len(b) else np.ones(len(a)) for a, b in zip(crops, others, strict=True)]
    side = float(np.clip(_SIDE * place.apart_m, _CLOSE_M, _FAR_M))
    view = find_heaviest_square(np.concatenate(crops), np.concatenate(weights), side)
    pictures = []
    for k, points in enumerate(crops):
        figure, axes = make_square(view)
        shown = points[are_inside(points, view)]
        axes.plot(*shown.T, ".", color=style_of(k)["color"], markersize=3.5, markeredgewidth=0, alpha=0.6)
        pictures.append(encode_png(figure))
    return tuple(pictures)


def find_common_frame(
    tracks: Sequence[Trajectory], truth: Trajectory | None
) -> tuple[list[se2.Array], NDArray[np.float64] | None]:
    """Finds one frame for all trajectories: that of the ground truth, or that of their common start.

    Args:
        tracks: the trajectories.
        truth: ground truth, or None.

    Returns:
        motions (3,) that bring every trajectory into the frame, and positions (N, 2) [m] of the part of the truth that
        they cover; None where there is no truth on which all of them can be laid.
    """
    if truth is not None:
        motions = [motion for track in tracks if (motion := align_positions(track, truth)) is not None]
        if tracks and len(motions) == len(tracks):
            first, last = min(t.stamps_us[0] for t in tracks), max(t.stamps_us[-1] for t in tracks)
            covered = (truth.stamps_us >= first) & (truth.stamps_us <= last)
            return motions, truth.poses[covered, :2]
    begin = np.array([max((t.stamps_us[0] for t in tracks), default=0)])
    return [se2.inverse(t.at(begin)[0]) for t in tracks], None


def _make_row_chart(rows: Sequence[JudgedRow], ylabel: str, xlabel: str = "time [s]") -> tuple[Figure, Axes]:
    """Returns an empty figure with room for a legend of all rows."""
    return make_chart(ylabel, xlabel, above_in=_measure_legend([row.row.name + _COUNT for row in rows])[1])


def _put_legend(axes: Axes, names: Sequence[str]) -> None:
    if names:
        put_legend_strip(axes, _measure_legend(names)[0])


def _measure_legend(names: Sequence[str]) -> tuple[int, float]:
    """Returns the number of columns and the height [inch] of a legend of these names."""
    longest = max((len(name) for name in names), default=1)
    columns = int(np.clip(_ACROSS_IN / (_KEY_IN + _LETTER_IN * longest), 1, 4))
    return columns, _LINE_IN * -(-len(names) // columns) + 0.1


def _escape(name: str) -> str:
    """Returns a name such that a legend shows it as it is: without mathematics, and also with an underscore in front."""
    return (" " if name.startswith("_") else "") + name.replace("$", r"\$")


def style_of(k: int) -> dict[str, Any]:
    """Returns colour and style of the line of row k."""
    return {"color": _COLOURS[k % len(_COLOURS)], "linestyle": _STYLES[k % len(_STYLES)]}
