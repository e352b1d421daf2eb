"""Draws maps and charts as PNG and SVG: dark ink on a transparent background, and the same bytes for the same data."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mqslam.core.statistics import pick_evenly
from mqslam.core.stored import release
from mqslam.formats.pictures import encode_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure
    from matplotlib.patheffects import AbstractPathEffect

Points: TypeAlias = NDArray[np.float64]

# the looks of the figures; no result depends on them
INK = "#1c2430"
BLUE, ORANGE, GREEN, RED, VIOLET, PURPLE = "#1d5fd1", "#d9620d", "#16803c", "#c81e1e", "#7a3db8", "#a8327e"
GREY, TRUTH_GREY = "#7b8594", "#9aa3af"
OUTERMOST = 0.005  # share of a map's points that may lie beyond each edge of its picture
MAP_SHAPE, PATH_SHAPE, SQUARE = (0.5, 1.3), (1.0, 1.2), (1.0, 1.0)  # least and greatest ratio of height to width
SHEET_SHAPE = (0.3, 1.3)  # the same for a figure for print, which need not match other pictures
DPI = 200  # pixels per inch
_SOFT = "#8a94a3"
_WIDTH_IN, _SMALL_IN = 6.4, 2.6  # width of a figure and of a small one
_LEFT_IN, _RIGHT_IN, _BOTTOM_IN, _TOP_IN = 0.78, 0.12, 0.48, 0.12  # margins around the axes
_BESIDE = 0.125  # share of the figure's width for the numbers and the title of a y axis on the right
_ENOUGH = 300_000  # number of points counted at a time, and largest number from which the edges of a view are found
_FAINTEST = 0.35  # opacity of a pixel with a single point
_LINE_IN, _LETTER_IN, _KEY_IN, _ACROSS_IN = 0.19, 0.075, 0.5, 5.7  # legend: line height; letter, key, total width
_CHART_IN = 1.7  # height of a chart below a map
_PAD_IN = 0.06  # margin around all that is drawn in a figure for print, so that no label is cut
_LARGEST_ELLIPSE = 0.015  # largest radius of an enlarged ellipse, as a share of the picture's width
_ELLIPSES = 150  # most ellipses that are shown, so that a long path is not covered by them
_CORNERS = 24  # corners of an ellipse
_MOST = 1200  # most points of a line that a chart draws: nobody could see more
_ROUTE, _WIDER, _WIDEST = 1.4, 1.6, 8.0  # width of the last of several routes; by how much the others grow, each and in all


@dataclass(frozen=True, slots=True)
class View:
    """The rectangle of the map's frame that several figures show: x from `x0` to `x1` [m], y from `y0` to `y1` [m]."""

    x0: float
    x1: float
    y0: float
    y1: float

    def contains(self, points: Points) -> NDArray[np.bool_]:
        """Returns whether each of the points (N, 2) [m] lies in the view (N,)."""
        x, y = points.T
        return np.asarray((x >= self.x0) & (x <= self.x1) & (y >= self.y0) & (y <= self.y1))


@dataclass(frozen=True, slots=True)
class Curve:
    """A line or dots in a chart or on a map.

    Args:
        name: name in the legend; empty for no entry in the legend.
        colour: colour of the curve.
        points: (N, 2) x and y of each point, in the units of the axes ([m] on a map); a row of NaN interrupts a line.
        style: style of a line, or marker of dots, as matplotlib names it; `-o` and `--o` for lines with dots.
        width: width of the line, or size of the dots [points of 1/72 inch].
        alpha: opacity of the curve, 0..1.
        beside: whether the curve belongs to the axis on the right of a chart.
        shown: whether an interactive map shows the curve at first.
    """

    name: str
    colour: str
    points: Points
    style: Any = "-"
    width: float = 1.4
    alpha: float = 1.0
    beside: bool = False
    shown: bool = True

    @property
    def is_dots(self) -> bool:
        """Whether the curve is drawn as dots rather than as a line."""
        return self.style in ("o", "^", "s", "x", ".", "|")


@dataclass(frozen=True, slots=True)
class Chart:
    """A chart of curves over time or distance, with one y axis or two.

    Args:
        title: title of the left y axis, with its unit.
        curves: the curves.
        levels: name, value and colour of each horizontal line across the chart.
        log: names of the logarithmic axes: `x`, `y` for the left y axis, and `beside` for the right y axis.
        x_title: title of the x axis.
        beside: title of the right y axis; empty for no such axis.
        top: upper end of the y axes; None fits it to the values.
    """

    title: str
    curves: tuple[Curve, ...]
    levels: tuple[tuple[str, float, str], ...] = ()
    log: Collection[str] = ()
    x_title: str = "time [s]"
    beside: str = ""
    top: float | None = None


class Drawing(NamedTuple):
    """The content of a picture: maps, each as points (N, 2) [m] and their colour, and curves over the maps."""

    maps: Sequence[tuple[Points, str]] = ()
    curves: Sequence[Curve] = ()


def over(x: Any, y: Any) -> Points:
    """Returns the points (N, 2) of a curve, whose x and y are given as arrays or lists (N,)."""
    return np.column_stack([x, y]).astype(np.float64).reshape(-1, 2)


def join_lines(lines: Sequence[Points]) -> Points:
    """Joins lines, each of points (N_k, 2), to one array (M, 2) with a row of NaN after each line."""
    gap = np.full((1, 2), np.nan)
    return np.concatenate([part for one in lines for part in (one, gap)]) if lines else np.empty((0, 2))


def draw_routes(routes: Sequence[tuple[str, str, Points]]) -> list[Curve]:
    """Returns lines of routes; each is wider than the lines drawn over it, so that all routes along one road are seen.

    Args:
        routes: name in the legend, colour, and points (N, 2) [m] of each route, in the order in which they are drawn.
    """
    wider = min(_WIDER, _WIDEST / len(routes))
    return [Curve(*route, width=_ROUTE + wider * over_it) for over_it, route in enumerate(reversed(routes))][::-1]


def draw_ellipses(positions: Points, covariances: NDArray[np.float64], shown: Sequence[Points]) -> tuple[Curve, float]:
    """Returns a curve of 3-sigma ellipses, enlarged if they are too small to be seen, and their largest true radius [m].

    If there are more than `_ELLIPSES` positions, this number of them is picked evenly, for the curve and for the radius. Of
    ellipses that would overlap, only the last is drawn, so that they do not cover the path.

    Args:
        positions: (N, 2) middle x, y of each ellipse [m].
        covariances: (N, 2, 2) in x, y [m], or (N, 3, 3) in x, y, yaw, of which x and y are drawn; in the positions' frame.
        shown: arrays of points (M, 2) [m] of the picture, whose extent decides how large the ellipses are drawn.
    """
    round_trip = np.linspace(0.0, 2.0 * np.pi, _CORNERS + 1)
    circle = np.column_stack([np.cos(round_trip), np.sin(round_trip)])
    picked = pick_evenly(len(positions), _ELLIPSES)
    centres, shapes, reaches = positions[picked], [], []
    for covariance in covariances[picked]:
        values, axes = np.linalg.eigh(covariance[:2, :2])
        radii = 3.0 * np.sqrt(np.maximum(values, 0.0))
        shapes.append(circle * radii @ axes.T)
        reaches.append(float(radii.max()))
    largest, view = max(reaches, default=0.0), find_common_view(shown, SHEET_SHAPE, OUTERMOST)
    factor = _round_down(_LARGEST_ELLIPSE * (view.x1 - view.x0) / largest) if largest > 0.0 else 1.0
    apart: list[int] = []
    for k in reversed(range(len(picked))):
        if all(math.dist(centres[k], centres[other]) >= factor * (reaches[k] + reaches[other]) for other in apart):
            apart.insert(0, k)
    name = "3σ ellipses" if factor == 1.0 else f"3σ ellipses, drawn {factor:g} times as large"
    return Curve(name, PURPLE, join_lines([centres[k] + factor * shapes[k] for k in apart]), width=1.2), largest


def _round_down(factor: float) -> float:
    """Returns the largest of the numbers 1, 2, 5, 10, 20, ... that is not above `factor`; 1 for a smaller factor."""
    steps = (n * 10.0**k for k in range(6) for n in (1, 2, 5))
    return max((step for step in steps if step <= factor), default=1.0)


def mix_shades(count: int) -> tuple[str, ...]:
    """Returns the colours of `count` groups in the order of time, from blue for the first to orange for the last group."""
    ends = np.array([[int(colour[k : k + 2], 16) for k in (1, 3, 5)] for colour in (BLUE, ORANGE)])
    mixed = [(1.0 - share) * ends[0] + share * ends[1] for share in np.linspace(0.0, 1.0, count)]
    return tuple("#" + "".join(f"{round(part):02x}" for part in colour) for colour in mixed)


def find_common_view(positions: Sequence[Points], shape: tuple[float, float], left_out: float = 0.0) -> View:
    """Returns the rectangle around all positions, with a margin of 3 % on each side, and at least 1 m wide and high.

    Args:
        positions: arrays (N, 2) [m], of which at least one is not empty; NaN is ignored.
        shape: least and greatest ratio of the rectangle's height to its width; the rectangle is enlarged to meet them.
        left_out: share (0 to 1) of each array's positions that may lie beyond each side of the rectangle, since a few far
            points would make everything else too small.
    """
    filled = [p[pick_evenly(len(p), _ENOUGH)] for p in positions if len(p)]
    release(*positions)
    lows = np.array([np.nanquantile(p, left_out, axis=0) for p in filled]).min(axis=0)
    highs = np.array([np.nanquantile(p, 1.0 - left_out, axis=0) for p in filled]).max(axis=0)
    width, height = np.maximum(1.06 * (highs - lows), 1.0)
    half = 0.5 * np.array([max(width, height / shape[1]), max(height, width * shape[0])])
    (x0, y0), (x1, y1) = (0.5 * (lows + highs) - half).tolist(), (0.5 * (lows + highs) + half).tolist()
    return View(x0, x1, y0, y1)


def draw_world(
    drawings: Sequence[Drawing],
    shape: tuple[float, float] = MAP_SHAPE,
    *,
    view: View | None = None,
    is_small: bool = False,
    opaque: bool = False,
) -> list[bytes]:
    """Draws maps and paths from above as PNG files, which share their extent, their scale and the shades for point density.

    Args:
        drawings: content of each picture; all need the same named curves, since every legend has the first picture's names.
        shape: least and greatest ratio of a picture's height to its width.
        view: part of the world that is shown; None shows everything that is drawn.
        is_small: whether the pictures are small squares without ticks.
        opaque: whether the background is white, for pictures outside a page, rather than transparent.

    Returns:
        The content of a PNG file for each picture.
    """
    view = view or _find_view(drawings, shape)
    names = [curve.name for curve in drawings[0].curves if curve.name]
    made = [_make_small(view) if is_small else make_world(view, _measure_legend(names)[1]) for _ in drawings]
    lay_ink(view, [(axes, *one) for (_, axes), drawing in zip(made, drawings, strict=True) for one in drawing.maps])
    pictures = []
    for (figure, axes), drawing in zip(made, drawings, strict=True):
        for curve in drawing.curves:
            _plot(axes, curve)
        _put_legend(axes, names)
        pictures.append(encode_png(figure, opaque))
    return pictures


def _find_view(drawings: Sequence[Drawing], shape: tuple[float, float]) -> View:
    """Returns the rectangle around all that is drawn; if maps are drawn, the outermost points may lie beyond its sides."""
    maps = [points for drawing in drawings for points, _ in drawing.maps]
    drawn = [*maps, *(curve.points for drawing in drawings for curve in drawing.curves)]
    return find_common_view(drawn or [np.zeros((1, 2))], shape, OUTERMOST if maps else 0.0)


def draw_chart(chart: Chart) -> bytes:
    """Draws a chart as an SVG element, with a legend above it."""
    above_in = _measure_legend(_name_curves(chart))[1]
    figure, axes = _make_axes(3.0 + above_in, above_in)
    _fill(axes, chart)
    return _encode_svg(figure)


def _name_curves(chart: Chart) -> list[str]:
    """Returns the names in the legend of a chart."""
    return [name for name in (*(curve.name for curve in chart.curves), *(level[0] for level in chart.levels)) if name]


def _fill(axes: Axes, chart: Chart) -> None:
    """Draws the curves, the levels and the legend of a chart on empty axes."""
    axes.set(xlabel=chart.x_title, ylabel=chart.title)
    sides = {"y": axes}
    if chart.beside:
        sides["beside"] = beside = axes.twinx()
        beside.spines[["top", "left", "bottom"]].set_visible(False)
        beside.tick_params(colors=INK, labelsize=10)
        beside.set_ylabel(chart.beside, color=INK, fontsize=10)
        box = axes.get_position()
        for side in sides.values():
            side.set_position((box.x0, box.y0, box.width - _BESIDE, box.height))
    for name in chart.log:
        _use_plain_log(sides.get(name, axes), "x" if name == "x" else "y")
    for curve in chart.curves:
        points = curve.points if curve.is_dots else curve.points[pick_evenly(len(curve.points), _MOST)]
        _plot(sides["beside" if curve.beside else "y"], curve, points)
    for name, value, colour in chart.levels:
        axes.axhline(value, color=colour, linewidth=1.2, linestyle="--" if colour == INK else "-", label=name)
    for name, side in sides.items():
        drawn = [curve.points[:, 1] for curve in chart.curves if curve.beside == (name == "beside")]
        if name not in chart.log and np.nanmin(np.concatenate(drawn or [np.zeros(1)]), initial=0.0) >= 0.0:
            side.set_ylim(bottom=0.0, top=chart.top)
    handles = [handle for side in sides.values() for handle in side.get_legend_handles_labels()[0]]
    _put_legend(axes, _name_curves(chart), handles)


def draw_sheet(drawing: Drawing, charts: Sequence[Chart], suffix: str) -> bytes:
    """Draws a map with charts below it as one figure for print, on white; in PDF and SVG, words stay text.

    Args:
        drawing: the map and the curves on it.
        charts: the charts, from top to bottom.
        suffix: form of the file: `.pdf`, `.png` or `.svg`.

    Returns:
        The content of the file.
    """
    from matplotlib.figure import Figure

    view = _find_view([drawing], SHEET_SHAPE)
    names = [curve.name for curve in drawing.curves if curve.name]
    inner = _WIDTH_IN - _LEFT_IN - _RIGHT_IN
    heights = [inner * (view.y1 - view.y0) / (view.x1 - view.x0), *(_CHART_IN for _ in charts)]
    above = [_measure_legend(listed)[1] for listed in (names, *map(_name_curves, charts))]
    total = sum(heights) + sum(above) + len(heights) * (_BOTTOM_IN + _TOP_IN)
    figure, top = Figure(figsize=(_WIDTH_IN, total), dpi=DPI), total
    panels = []
    for height, legend in zip(heights, above, strict=True):
        top -= _TOP_IN + legend + height
        panels.append(figure.add_axes((_LEFT_IN / _WIDTH_IN, top / total, inner / _WIDTH_IN, height / total)))
        _style(panels[-1])
        top -= _BOTTOM_IN
    world = panels[0]
    world.set(xlabel="x [m]", ylabel="y [m]", xlim=(view.x0, view.x1), ylim=(view.y0, view.y1))
    lay_ink(view, [(world, *one) for one in drawing.maps])
    for curve in drawing.curves:
        _plot(world, curve)
    _put_legend(world, names)
    for axes, chart in zip(panels[1:], charts, strict=True):
        _fill(axes, chart)
    return encode_figure(figure, suffix, DPI, facecolor="white", bbox_inches="tight", pad_inches=_PAD_IN)


def make_world(view: View, above_in: float = 0.0) -> tuple[MplFigure, Axes]:
    """Returns an empty figure of the world from above, with x to the right and the same scale along x and y, and its axes.

    Args:
        view: part of the world that the figure shows.
        above_in: height of the empty space above the axes [inch].
    """
    inner = _WIDTH_IN - _LEFT_IN - _RIGHT_IN
    height = inner * (view.y1 - view.y0) / (view.x1 - view.x0)
    figure, axes = _make_axes(height + _BOTTOM_IN + _TOP_IN + above_in, above_in)
    axes.set(xlabel="x [m]", ylabel="y [m]", xlim=(view.x0, view.x1), ylim=(view.y0, view.y1))
    return figure, axes


def _make_small(view: View) -> tuple[MplFigure, Axes]:
    """Returns a small figure that shows an empty square of the world with a scale bar instead of ticks, and its axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_SMALL_IN, _SMALL_IN), dpi=DPI)
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


def _make_axes(height_in: float, above_in: float) -> tuple[MplFigure, Axes]:
    """Returns an empty figure of height `height_in` [inch], with axes, a grid, and `above_in` [inch] of space above them."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH_IN, height_in), dpi=DPI)
    left, bottom, top = _LEFT_IN / _WIDTH_IN, _BOTTOM_IN / height_in, (_TOP_IN + above_in) / height_in
    axes = figure.add_axes((left, bottom, 1 - left - _RIGHT_IN / _WIDTH_IN, 1 - bottom - top))
    _style(axes)
    return figure, axes


def _style(axes: Axes) -> None:
    """Gives axes their grid, spines and ticks."""
    axes.grid(color=INK, alpha=0.12, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(_SOFT)
    axes.tick_params(colors=INK, labelsize=10, color=_SOFT)
    axes.xaxis.label.set(color=INK, fontsize=10)
    axes.yaxis.label.set(color=INK, fontsize=10)


def make_halo() -> list[AbstractPathEffect]:
    """Returns a white outline for text or lines, which makes them stand out from the map below them."""
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=2.5, foreground="white")]


def _plot(axes: Axes, curve: Curve, points: Points | None = None) -> None:
    """Draws a curve on axes; `points` (N, 2) are drawn instead of all points of the curve if they are given."""
    look: dict[str, Any] = {"linestyle": curve.style, "linewidth": curve.width, "solid_joinstyle": "round"}
    if curve.is_dots:
        look = {"linestyle": "", "marker": curve.style, "markersize": curve.width, "clip_on": curve.style != "|"}
        look |= {"fillstyle": "none"} if curve.style == "s" else {} if curve.style in "x|" else {"markeredgewidth": 0}
    elif curve.style in ("-o", "--o"):
        look |= {"linestyle": curve.style[:-1], "marker": "o", "markersize": 4}
    name = (" " if curve.name.startswith("_") else "") + curve.name.replace("$", r"\$")  # shown literally in a legend
    x, y = (curve.points if points is None else points).T
    axes.plot(x, y, color=curve.colour, alpha=curve.alpha, label=name or None, **look)


def _measure_legend(names: Sequence[str]) -> tuple[int, float]:
    """Returns the number of columns and the height [inch] of a legend of these names."""
    longest = max((len(name) for name in names), default=1)
    columns = int(np.clip(_ACROSS_IN / (_KEY_IN + _LETTER_IN * longest), 1, 4))
    return columns, _LINE_IN * -(-len(names) // columns) + 0.1 if names else 0.0


def _put_legend(axes: Axes, names: Sequence[str], handles: Sequence[Any] | None = None) -> None:
    """Puts a compact legend of `names` into the space above the axes, or no legend without names.

    The `handles` are matplotlib's handles of the curves in the legend; None takes all curves with a name on the axes.
    """
    if not names:
        return
    tight: dict[str, Any] = {
        "handletextpad": 0.4,
        "columnspacing": 1.2,
        "handlelength": 1.9,
        "borderaxespad": 0.2,
        "fontsize": 9,
    }
    columns = _measure_legend(names)[0]
    shown = axes.get_legend_handles_labels()[0] if handles is None else handles
    axes.legend(handles=shown, frameon=False, loc="lower left", bbox_to_anchor=(-0.08, 1.0), ncols=columns, **tight)


def _use_plain_log(axes: Axes, which: str) -> None:
    """Makes the axis `which` (`x` or `y`) logarithmic, with ticks such as 1, 2, 5, 10; on a wide axis, powers of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set(**{f"{which}scale": "log"})
    axis = axes.xaxis if which == "x" else axes.yaxis

    def plain(value: float, _: int | None) -> str:
        low, high = sorted(axis.get_view_interval())
        first = f"{value:e}"[0]
        return f"{value:g}" if first == "1" or (high < 100.0 * low and first in "25") else ""

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=40))
    axis.set_major_formatter(FuncFormatter(plain))
    axis.set_minor_formatter(NullFormatter())


def lay_ink(view: View, maps: Sequence[tuple[Axes, Points, str]]) -> None:
    """Draws maps by their density: a pixel's opacity grows with the logarithm of the number of points in the pixel.

    Args:
        view: part of the world that all axes show.
        maps: axes to draw on, points (N, 2) [m] and colour of each map. All axes have the same size, and all maps share
            one scale of opacity, in which a single point is visible.
    """
    from matplotlib.colors import to_rgb

    if not maps:
        return
    figure = maps[0][0].get_figure(root=True)
    assert figure is not None
    columns = round(maps[0][0].get_position().width * figure.get_figwidth() * DPI)
    counts = [_count_pixels(points, view, columns) for _, points, _ in maps]
    seen = np.concatenate([count[count > 0] for count in counts])
    well_seen = float(np.percentile(seen, 99.5)) if len(seen) else 1.0
    for (axes, _, colour), count in zip(maps, counts, strict=True):
        share = np.log1p(count) / np.log1p(max(well_seen, 2.0))
        opacity = np.where(count > 0, np.clip(_FAINTEST + (1.0 - _FAINTEST) * share, 0.0, 1.0), 0.0)
        image = np.empty((*count.shape, 4), dtype=np.uint8)
        image[..., :3] = np.round(255.0 * np.array(to_rgb(colour)))
        image[..., 3] = np.round(255.0 * opacity)
        extent = (view.x0, view.x1, view.y0, view.y1)
        axes.imshow(image, extent=extent, origin="lower", interpolation="nearest", aspect="auto")


def _count_pixels(points: Points, view: View, columns: int) -> NDArray[np.int64]:
    """Counts the points (N, 2) [m] in each square pixel of a view; returns (rows, columns), with row 0 at the lowest y."""
    side = (view.x1 - view.x0) / columns
    rows = max(round((view.y1 - view.y0) / side), 1)
    counts = np.zeros(rows * columns, dtype=np.int64)
    for begin in range(0, len(points), _ENOUGH):
        column, row = np.floor((points[begin : begin + _ENOUGH] - [view.x0, view.y0]) / side).astype(np.int64).T
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        counts += np.bincount(row[inside] * columns + column[inside], minlength=rows * columns)
        release(points)
    return counts.reshape(rows, columns)


def encode_png(figure: MplFigure, opaque: bool = False) -> bytes:
    """Returns a figure as the content of a PNG file; its background is white if `opaque`, else transparent."""
    return encode_figure(figure, ".png", DPI, transparent=not opaque, facecolor="white" if opaque else "none")


_SVG: Final = b"<svg"
_NOT_SHOWN: Final = re.compile(  # parts that a page does not need, or that would affect the whole page
    r'<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->| xmlns(?::\w+)?="[^"]*"| version="[^"]*"', re.DOTALL
)
_NAMED_GROUP: Final = re.compile(r'<g id="[^"]*">')  # the names repeat from chart to chart, and nothing refers to them
_SIZE: Final = re.compile(r'(<svg[^>]*?) (?:width|height)="[^"]*"')
_FONT: Final = re.compile(r"(font(?:-family)?: [^';\"]*)'[^;\"]*")


def _encode_svg(figure: MplFigure) -> bytes:
    """Returns a figure as an SVG element for a page, in which its words can be searched, copied and read aloud."""
    text = encode_figure(figure, ".svg", DPI, transparent=True).decode("utf-8")
    text = _NOT_SHOWN.sub("", text[text.index(_SVG.decode()) :])
    text = _SIZE.sub(r"\1", _SIZE.sub(r"\1", text, count=1), count=1)
    text = _FONT.sub(r"\1sans-serif", _NAMED_GROUP.sub("<g>", text))
    return re.sub(r"\s*\n\s*", "\n", text).strip().encode("utf-8")


def is_svg(picture: bytes) -> bool:
    """Returns whether a picture is an SVG element rather than a PNG file."""
    return picture.startswith(_SVG)
