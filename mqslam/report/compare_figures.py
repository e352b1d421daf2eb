"""Figures of a comparison's report: every row in its own colour and line style in all of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from mqslam.compare.judgement import Judged, Place
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.evaluation import align_positions
from mqslam.report.audit_figures import EXPECTED
from mqslam.report.canvas import (
    INK,
    PATH_SHAPE,
    RED,
    chart,
    common_view,
    halo,
    legend_strip,
    plain_log,
    png,
    square,
    world,
)
from mqslam.report.crops import distances, inside, where_it_shows

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = ("#0b5fb0", "#d55e00", "#00886a", "#a8327e", "#7a5c00", "#3aa5dd")
_STYLES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (6, 1.5, 1, 1.5, 1, 1.5)))
_TRUTH = "#9aa3af"
_COUNT = " (999)"  # room for what may follow a name in a legend
_LINE_IN = 0.19  # height of a line of a legend
_LETTER_IN, _KEY_IN, _ACROSS_IN = 0.075, 0.5, 5.7  # width of its parts and of all of it
_MIDDLE_OF = 15  # windows that a running median is taken of
_CLOSE, _FAR = 20.0, 100.0  # shortest and longest side of a crop [m]
_SIDE = 25.0  # side of a crop per how far the rows are apart
_MOST_M = 1.0  # a point counts no more than this for where a crop is taken


def overlay(rows: Sequence[Judged], truth: Trajectory | None, *, opaque: bool = True) -> bytes:
    """All trajectories over each other.

    Args:
        rows: those that ran.
        truth: each is laid on it by the best rigid motion; without it all start from one pose.
        opaque: on white, to be looked at by itself; otherwise on a transparent ground, for a page.
    """
    tracks = {row.row.name: row.row.trajectory for row in rows if row.row.trajectory is not None}
    names = list(tracks)
    motions, shown = placed(list(tracks.values()), truth)
    paths = [se2.compose(m, t.poses)[:, :2] for m, t in zip(motions, tracks.values(), strict=True)]
    entries = names if shown is None else ["ground truth", *names]
    drawn = [*paths, *([] if shown is None else [shown])]
    figure, axes = world(common_view(drawn or [np.zeros((1, 2))], PATH_SHAPE), _legend_room(entries)[1])
    if shown is not None:
        axes.plot(*shown.T, color=_TRUTH, linewidth=5, alpha=0.6, solid_joinstyle="round", label="ground truth")
    for k, (name, path) in enumerate(zip(names, paths, strict=True)):
        axes.plot(*path.T, label=_as_text(name), linewidth=1.6, **look(k))
    _legend(axes, entries)
    return png(figure, opaque)


def inflation_chart(rows: Sequence[Judged], limit: float) -> bytes:
    """Inflation of all rows' windows over time: a dot each, and their running median as a line.

    Args:
        rows: those that ran.
        limit: inflation beyond which a window is torn.
    """
    figure, axes = _row_chart(rows, "inflation")
    plain_log(axes, "y")
    for k, row in enumerate(rows):
        windows = row.audit.windows
        if not windows:
            continue
        time = np.array([0.5 * (w.t0 + w.t1) for w in windows])
        inflation = np.maximum([w.bend.inflation for w in windows], 1e-2)
        drawn = look(k)
        axes.plot(time, inflation, ".", color=drawn["color"], markersize=3, markeredgewidth=0, alpha=0.35)
        smooth = median_filter(inflation, min(_MIDDLE_OF, len(inflation)), mode="nearest")
        axes.plot(time, smooth, label=_as_text(row.row.name), linewidth=1.6, **drawn)
    for height, said, colour in ((EXPECTED, f"expected {EXPECTED:.2f}", INK), (limit, f"threshold {limit:.1f}", RED)):
        axes.axhline(height, color=colour, linewidth=1.0, alpha=0.6)
        text = axes.text(
            0.995, height, said, transform=axes.get_yaxis_transform(), ha="right", va="bottom", fontsize=9, color=colour
        )
        text.set_path_effects(halo())
    _legend(axes, [row.row.name + _COUNT for row in rows])
    return png(figure)


def revisit_chart(rows: Sequence[Judged]) -> bytes:
    """Which share of every row's sure revisits is off by less than a length."""
    figure, axes = _row_chart(rows, "revisits [%]", "offset less than [m]")
    plain_log(axes, "x")
    for k, row in enumerate(rows):
        offsets = np.sort([r.revisit.distance_m for r in row.audit.revisits if r.revisit.sure])
        if len(offsets):
            reached = 100.0 * np.arange(1, len(offsets) + 1) / len(offsets)
            label = f"{_as_text(row.row.name)} ({len(offsets)})"
            axes.step(np.maximum(offsets, 1e-3), reached, where="post", label=label, linewidth=1.6, **look(k))
    axes.set_ylim(0.0, 102.0)
    _legend(axes, [row.row.name + _COUNT for row in rows])
    return png(figure)


def place_pictures(rows: Sequence[Judged], number: int, place: Place) -> tuple[bytes, ...]:
    """One place under every row, on one extent, where the rows differ most.

    Args:
        rows: those that ran.
        number: of the place among their crops.
        place: it.
    """
    crops = [row.crops[number] for row in rows]
    others = [*crops[1:], *crops[:1]]
    weights = [distances(a, b, _MOST_M) if len(b) else np.ones(len(a)) for a, b in zip(crops, others, strict=True)]
    side = float(np.clip(_SIDE * place.apart_m, _CLOSE, _FAR))
    view = where_it_shows(np.concatenate(crops), np.concatenate(weights), side)
    pictures = []
    for k, points in enumerate(crops):
        figure, axes = square(view)
        shown = points[inside(points, view)]
        axes.plot(*shown.T, ".", color=look(k)["color"], markersize=3.5, markeredgewidth=0, alpha=0.6)
        pictures.append(png(figure))
    return tuple(pictures)


def placed(tracks: Sequence[Trajectory], truth: Trajectory | None) -> tuple[list[se2.Array], NDArray[np.float64] | None]:
    """Motions (3,) that bring every trajectory into one frame, and positions (N, 2) [m] of the truth's part they cover."""
    if truth is not None:
        onto = [motion for track in tracks if (motion := align_positions(track, truth)) is not None]
        if tracks and len(onto) == len(tracks):
            first, last = min(t.stamps_us[0] for t in tracks), max(t.stamps_us[-1] for t in tracks)
            covered = (truth.stamps_us >= first) & (truth.stamps_us <= last)
            return onto, truth.poses[covered, :2]
    begin = np.array([max((t.stamps_us[0] for t in tracks), default=0)])
    return [se2.inverse(t.at(begin)[0]) for t in tracks], None


def _row_chart(rows: Sequence[Judged], ylabel: str, xlabel: str = "time [s]") -> tuple[Figure, Axes]:
    return chart(ylabel, xlabel, above_in=_legend_room([row.row.name + _COUNT for row in rows])[1])


def _legend(axes: Axes, names: Sequence[str]) -> None:
    if names:
        legend_strip(axes, _legend_room(names)[0])


def _legend_room(names: Sequence[str]) -> tuple[int, float]:
    """Columns and height [inch] of a legend of these names."""
    longest = max((len(name) for name in names), default=1)
    columns = int(np.clip(_ACROSS_IN / (_KEY_IN + _LETTER_IN * longest), 1, 4))
    return columns, _LINE_IN * -(-len(names) // columns) + 0.1


def _as_text(name: str) -> str:
    """A name that a legend shows as it is: no mathematics, not left out for an underscore in front."""
    return (" " if name.startswith("_") else "") + name.replace("$", r"\$")


def look(k: int) -> dict[str, Any]:
    """Colour and style of the line of row k."""
    return {"color": _COLOURS[k % len(_COLOURS)], "linestyle": _STYLES[k % len(_STYLES)]}
