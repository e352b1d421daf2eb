"""The canvas of all figures: dark ink on a transparent ground, the same bytes for the same data."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from mqslam.core.statistics import pick_evenly
from mqslam.core.stored import release

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patheffects import AbstractPathEffect

# the looks of the figures; no result depends on them
INK = "#1c2430"
BLUE, ORANGE, GREEN, RED, VIOLET = "#1d5fd1", "#d9620d", "#16803c", "#c81e1e", "#7a3db8"
GREY = "#7b8594"
OUTERMOST = 0.005  # share of a map's points that may lie beyond each edge of its picture
MAP_SHAPE = (0.5, 1.3)  # least and greatest height of a map's picture, per width
PATH_SHAPE = (1.0, 1.2)  # the same for a picture of trajectories
DPI = 200  # pixels per inch
_SOFT = "#8a94a3"
_WIDTH_IN = 6.4  # width of a figure
_LEFT_IN, _RIGHT_IN, _BOTTOM_IN, _TOP_IN = 0.78, 0.12, 0.48, 0.12  # margins around the axes
_ENOUGH = 300_000  # points that are looked at at a time, and of which the edges of a view are taken
_FAINTEST = 0.35  # opacity of a pixel with a single point


@dataclass(frozen=True, slots=True)
class View:
    """A rectangle of the world [m] that several figures share."""

    x0: float
    x1: float
    y0: float
    y1: float


def find_common_view(positions: list[NDArray[np.float64]], shape: tuple[float, float], left_out: float = 0.0) -> View:
    """Returns the rectangle around all positions.

    Args:
        positions: arrays (N, 2) [m], one of them not empty.
        shape: least and greatest height of the rectangle per width; it is enlarged to meet them.
        left_out: share of the positions that may lie beyond each side, so that a few stray ones do not shrink the rest.
    """
    filled = [p[pick_evenly(len(p), _ENOUGH)] for p in positions if len(p)]
    release(*positions)
    lows = np.array([np.quantile(p, left_out, axis=0) for p in filled]).min(axis=0)
    highs = np.array([np.quantile(p, 1.0 - left_out, axis=0) for p in filled]).max(axis=0)
    centre = 0.5 * (lows + highs)
    width, height = np.maximum(1.06 * (highs - lows), 1.0)
    width, height = max(width, height / shape[1]), max(height, width * shape[0])
    return View(
        float(centre[0] - width / 2),
        float(centre[0] + width / 2),
        float(centre[1] - height / 2),
        float(centre[1] + height / 2),
    )


def make_world(view: View, above_in: float = 0.0) -> tuple[Figure, Axes]:
    """Returns an empty figure of the world from above, x to the right, one metre as long along x as along y.

    Args:
        view: the part of the world it shows.
        above_in: room left above the axes [inch].
    """
    inner = _WIDTH_IN - _LEFT_IN - _RIGHT_IN
    height = inner * (view.y1 - view.y0) / (view.x1 - view.x0)
    figure, axes = _make_axes(height + _BOTTOM_IN + _TOP_IN + above_in, above_in)
    axes.set(xlabel="x [m]", ylabel="y [m]", xlim=(view.x0, view.x1), ylim=(view.y0, view.y1))
    return figure, axes


def make_chart(ylabel: str, xlabel: str = "time [s]", height_in: float = 3.0, above_in: float = 0.0) -> tuple[Figure, Axes]:
    """Returns an empty figure with time, or what xlabel says, along x.

    Args:
        ylabel: what the y axis shows, with its unit.
        xlabel: what the x axis shows, with its unit.
        height_in: height of the figure [inch].
        above_in: room left above the axes [inch].
    """
    figure, axes = _make_axes(height_in + above_in, above_in)
    axes.set(xlabel=xlabel, ylabel=ylabel)
    return figure, axes


def make_square(view: View, side_in: float = 2.6) -> tuple[Figure, Axes]:
    """Returns a small figure of a square of the world with a bar for scale; without ticks the square fills the picture."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(side_in, side_in), dpi=DPI)
    axes = figure.add_axes((0.005, 0.005, 0.99, 0.99))
    axes.set(xlim=(view.x0, view.x1), ylim=(view.y0, view.y1), xticks=[], yticks=[])
    axes.spines[:].set_color(_SOFT)
    side = view.x1 - view.x0
    length = max(n * 10.0**k for k in range(-2, 4) for n in (1, 2, 5) if n * 10.0**k <= 0.3 * side)
    x, y = view.x0 + 0.04 * side, view.y0 + 0.05 * side
    axes.plot([x, x + length], [y, y], color=INK, linewidth=2.5, solid_capstyle="butt", zorder=5)
    text = axes.text(x, y + 0.015 * side, f"{length:g} m", color=INK, fontsize=10, va="bottom", zorder=5)
    text.set_path_effects(make_halo())
    return figure, axes


def make_halo(width: float = 2.5) -> list[AbstractPathEffect]:
    """Returns a white edge for text or lines, so that they stand out from what they lie on."""
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=width, foreground="white")]


def _make_axes(height_in: float, above_in: float) -> tuple[Figure, Axes]:
    """Returns an empty figure with axes and a grid."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH_IN, height_in), dpi=DPI)
    left, bottom, top = _LEFT_IN / _WIDTH_IN, _BOTTOM_IN / height_in, (_TOP_IN + above_in) / height_in
    axes = figure.add_axes((left, bottom, 1 - left - _RIGHT_IN / _WIDTH_IN, 1 - bottom - top))
    axes.grid(color=INK, alpha=0.12, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(_SOFT)
    axes.tick_params(colors=INK, labelsize=10, color=_SOFT)
    axes.xaxis.label.set(color=INK, fontsize=10)
    axes.yaxis.label.set(color=INK, fontsize=10)
    return figure, axes


def count_points(axes: Axes, view: View, points: list[NDArray[np.float64]]) -> tuple[list[NDArray[np.int64]], float]:
    """Counts the points per pixel for several maps.

    Args:
        axes: axes the maps will be drawn on.
        view: the part of the world they show.
        points: (N, 2) [m] of each map.

    Returns:
        the counts (H, W) of each map, row 0 at the lowest y, and the count that all maps show in full ink.
    """
    figure = axes.get_figure(root=True)
    assert figure is not None
    columns = round(axes.get_position().width * figure.get_figwidth() * DPI)
    counts = [_count_pixels(p, view, columns) for p in points]
    seen = np.concatenate([c[c > 0] for c in counts])
    return counts, float(np.percentile(seen, 99.5)) if len(seen) else 1.0


def lay_ink(axes: Axes, view: View, counts: NDArray[np.int64], well_seen: float, colour: str = INK) -> None:
    """Draws counts as ink: opacity grows with their logarithm, and a single point is visible.

    Args:
        axes: axes to draw on.
        view: the part of the world they show.
        counts: (H, W) points per pixel, row 0 at the lowest y.
        well_seen: count that is drawn in full ink.
        colour: colour of the ink.
    """
    from matplotlib.colors import to_rgb

    share = np.log1p(counts) / np.log1p(max(well_seen, 2.0))
    opacity = np.where(counts > 0, np.clip(_FAINTEST + (1.0 - _FAINTEST) * share, 0.0, 1.0), 0.0)
    image = np.empty((*counts.shape, 4), dtype=np.uint8)
    image[..., :3] = np.round(255.0 * np.array(to_rgb(colour)))
    image[..., 3] = np.round(255.0 * opacity)
    extent = (view.x0, view.x1, view.y0, view.y1)
    axes.imshow(image, extent=extent, origin="lower", interpolation="nearest", aspect="auto")


def _count_pixels(points: NDArray[np.float64], view: View, columns: int) -> NDArray[np.int64]:
    """Counts points (N, 2) [m] per square pixel: (rows, columns), row 0 at the lowest y."""
    side = (view.x1 - view.x0) / columns
    rows = max(round((view.y1 - view.y0) / side), 1)
    counts = np.zeros(rows * columns, dtype=np.int64)
    for begin in range(0, len(points), _ENOUGH):
        counts += _count_part(points[begin : begin + _ENOUGH], view, side, (rows, columns))
        release(points)
    return counts.reshape(rows, columns)


def _count_part(points: NDArray[np.float64], view: View, side: float, shape: tuple[int, int]) -> NDArray[np.int64]:
    """Counts points (N, 2) [m] per pixel of a side [m]: (rows * columns,)."""
    rows, columns = shape
    column, row = np.floor((points - [view.x0, view.y0]) / side).astype(np.int64).T
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    return np.bincount(row[inside] * columns + column[inside], minlength=rows * columns)


def put_legend_above(axes: Axes) -> None:
    """Puts the legend above the plot, where it covers no data."""
    box = axes.get_position()
    axes.set_position((box.x0, box.y0, box.width, box.height - 0.08))
    axes.legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.2)


def put_legend_strip(axes: Axes, columns: int) -> None:
    """Puts a tight legend into the room left above the axes."""
    axes.legend(
        frameon=False,
        loc="lower left",
        bbox_to_anchor=(-0.08, 1.0),
        ncols=columns,
        borderaxespad=0.2,
        fontsize=9,
        handletextpad=0.4,
        columnspacing=1.2,
        handlelength=1.9,
    )


def use_plain_log(axes: Axes, which: Literal["x", "y"]) -> None:
    """Makes an axis logarithmic, with plain numbers at 1, 2 and 5, or at powers of ten where the span is wide."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    (axes.set_xscale if which == "x" else axes.set_yscale)("log")
    axis = axes.xaxis if which == "x" else axes.yaxis

    def plain(value: float, _: int | None) -> str:
        low, high = sorted(axis.get_view_interval())
        first = f"{value:e}"[0]
        return f"{value:g}" if first == "1" or (high < 100.0 * low and first in "25") else ""

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=40))
    axis.set_major_formatter(FuncFormatter(plain))
    axis.set_minor_formatter(NullFormatter())


def encode_png(figure: Figure, opaque: bool = False) -> bytes:
    """Returns a figure as a PNG file: transparent for a page, or on white to be looked at by itself."""
    file = io.BytesIO()
    ground = "white" if opaque else "none"
    figure.savefig(file, format="png", dpi=DPI, transparent=not opaque, facecolor=ground, metadata={"Software": None})
    return file.getvalue()
