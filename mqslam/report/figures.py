"""Figures of the report as PNG bytes: dark ink on a transparent ground, the same bytes for the same data."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mqslam.pointmap import PointMap
from mqslam.report.content import WindowScores
from mqslam.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ODOMETRY_COLOUR = "#d9620d"
OPTIMISED_COLOUR = "#1d5fd1"
TRUTH_COLOUR = "#16803c"
OUTERMOST = 0.005
_INK = "#1c2430"
_FAULT_COLOUR = "#c81e1e"
_DPI = 200
_WIDTH_IN = 6.4
_LEFT_IN, _RIGHT_IN, _BOTTOM_IN, _TOP_IN = 0.78, 0.12, 0.48, 0.12
_MAP_SHAPE = (0.5, 1.3)
_PATH_SHAPE = (1.0, 1.2)
_FAINTEST = 0.35


@dataclass(frozen=True, slots=True)
class View:
    """A rectangle of the world [m] that several figures share."""

    x0: float
    x1: float
    y0: float
    y1: float


def common_view(positions: list[NDArray[np.float64]], shape: tuple[float, float], left_out: float = 0.0) -> View:
    """The rectangle around all positions.

    Args:
        positions: arrays (N, 2) [m], one of them not empty.
        shape: least and greatest height of the rectangle as a multiple of its width; it is widened to meet them.
        left_out: share of the positions that may lie beyond each side, so that a few stray ones do not shrink the rest.
    """
    filled = [p for p in positions if len(p)]
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


def map_figures(
    maps: tuple[PointMap, PointMap], paths: tuple[Trajectory, Trajectory], colours: tuple[str, str]
) -> tuple[bytes, bytes]:
    """Two maps as images of the density of their points, on one extent, one scale and one shade of ink per count."""
    view = common_view([*(m.points for m in maps), *(p.poses[:, :2] for p in paths)], _MAP_SHAPE, OUTERMOST)
    figure, axes = _world(view)
    box = axes.get_position()
    columns = round(box.width * _WIDTH_IN * _DPI)
    counts = [_counts(m.points, view, columns) for m in maps]
    seen = np.concatenate([c[c > 0] for c in counts])
    well_seen = float(np.percentile(seen, 99.5)) if len(seen) else 1.0
    images = []
    for count, path, colour in zip(counts, paths, colours, strict=True):
        figure, axes = _world(view)
        axes.imshow(
            _ink(count, well_seen),
            extent=(view.x0, view.x1, view.y0, view.y1),
            origin="lower",
            interpolation="nearest",
            aspect="auto",
        )
        axes.plot(path.poses[:, 0], path.poses[:, 1], color=colour, linewidth=1.4)
        axes.plot(path.poses[0, 0], path.poses[0, 1], "o", color=colour, markersize=5)
        axes.set(xlim=(view.x0, view.x1), ylim=(view.y0, view.y1))
        images.append(_png(figure))
    return images[0], images[1]


def trajectory_figure(odometry: Trajectory, optimised: Trajectory, truth: Trajectory | None) -> bytes:
    """The trajectories from above; the truth must already be in their frame."""
    drawn = [p for p in (odometry, optimised, truth) if p is not None]
    view = common_view([p.poses[:, :2] for p in drawn], _PATH_SHAPE)
    figure, axes = _world(view)
    if truth is not None:
        axes.plot(
            truth.poses[:, 0], truth.poses[:, 1], color=TRUTH_COLOUR, linewidth=4, alpha=0.4, label="ground truth"
        )
    axes.plot(odometry.poses[:, 0], odometry.poses[:, 1], color=ODOMETRY_COLOUR, linewidth=1.4, label="odometry")
    axes.plot(optimised.poses[:, 0], optimised.poses[:, 1], color=OPTIMISED_COLOUR, linewidth=1.4, label="optimised")
    axes.plot(optimised.poses[0, 0], optimised.poses[0, 1], "o", color=_INK, markersize=5, label="start")
    axes.set(xlim=(view.x0, view.x1), ylim=(view.y0, view.y1))
    axes.legend(frameon=False, loc="best")
    return _png(figure)


def psi_figure(windows: WindowScores) -> bytes:
    """psi per point of every window over time, at its minimum and under odometry."""
    figure, axes = _chart("ψ per point")
    time = 0.5 * (windows.t0 + windows.t1)
    points = np.maximum(windows.points, 1)
    if np.isfinite(windows.psi_odometry).any():
        axes.plot(time, windows.psi_odometry / points, color=ODOMETRY_COLOUR, linewidth=1.2, label="under odometry")
    axes.plot(time, windows.psi_minimum / points, color=OPTIMISED_COLOUR, linewidth=1.2, label="at its minimum")
    unused = time[np.array([s != "converged" for s in windows.status], dtype=np.bool_)]
    if len(unused):
        height = np.full(len(unused), 0.02)
        label = f"no measurement ({len(unused)})"
        axes.plot(
            unused, height, "|", color=_FAULT_COLOUR, markersize=9, transform=axes.get_xaxis_transform(), label=label
        )
    axes.set_ylim(bottom=0.0)
    _legend_above(axes)
    return _png(figure)


def matched_figure(windows: WindowScores) -> bytes:
    """Share of every window's points that found a neighbour, over time."""
    figure, axes = _chart("matched points [%]")
    time = 0.5 * (windows.t0 + windows.t1)
    axes.fill_between(time, 100.0 * windows.matched, color=OPTIMISED_COLOUR, alpha=0.15, linewidth=0)
    axes.plot(time, 100.0 * windows.matched, color=OPTIMISED_COLOUR, linewidth=1.2)
    axes.set_ylim(0.0, 100.0)
    return _png(figure)


def _counts(points: NDArray[np.float64], view: View, columns: int) -> NDArray[np.int64]:
    """Points (N, 2) [m] per pixel, (rows, columns) of square pixels, row 0 at the lowest y."""
    side = (view.x1 - view.x0) / columns
    rows = max(round((view.y1 - view.y0) / side), 1)
    column, row = np.floor((points - [view.x0, view.y0]) / side).astype(np.int64).T
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    flat = np.bincount(row[inside] * columns + column[inside], minlength=rows * columns)
    return flat.reshape(rows, columns)


def _ink(counts: NDArray[np.int64], well_seen: float) -> NDArray[np.float64]:
    """Counts (H, W) as RGBA (H, W, 4): opacity grows with the logarithm, one point is visible, well_seen is full."""
    from matplotlib.colors import to_rgb

    share = np.log1p(counts) / np.log1p(max(well_seen, 2.0))
    image = np.empty((*counts.shape, 4))
    image[..., :3] = to_rgb(_INK)
    image[..., 3] = np.where(counts > 0, np.clip(_FAINTEST + (1.0 - _FAINTEST) * share, 0.0, 1.0), 0.0)
    return image


def _world(view: View) -> tuple[Figure, Axes]:
    """An empty figure of the world from above, x to the right, one metre as long along x as along y."""
    inner = _WIDTH_IN - _LEFT_IN - _RIGHT_IN
    figure, axes = _empty(inner * (view.y1 - view.y0) / (view.x1 - view.x0) + _BOTTOM_IN + _TOP_IN)
    axes.set(xlabel="x [m]", ylabel="y [m]")
    return figure, axes


def _chart(ylabel: str) -> tuple[Figure, Axes]:
    """An empty figure with time along x."""
    figure, axes = _empty(3.0)
    axes.set(xlabel="time [s]", ylabel=ylabel)
    return figure, axes


def _empty(height_in: float) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH_IN, height_in), dpi=_DPI)
    left, bottom = _LEFT_IN / _WIDTH_IN, _BOTTOM_IN / height_in
    axes = figure.add_axes((left, bottom, 1 - left - _RIGHT_IN / _WIDTH_IN, 1 - bottom - _TOP_IN / height_in))
    axes.grid(color=_INK, alpha=0.12, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("#8a94a3")
    axes.tick_params(colors=_INK, labelsize=10, color="#8a94a3")
    axes.xaxis.label.set(color=_INK, fontsize=10)
    axes.yaxis.label.set(color=_INK, fontsize=10)
    return figure, axes


def _legend_above(axes: Axes) -> None:
    """Put the legend above the plot, where it covers no data."""
    box = axes.get_position()
    axes.set_position((box.x0, box.y0, box.width, box.height - 0.08))
    axes.legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.2)


def _png(figure: Figure) -> bytes:
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=_DPI, transparent=True, metadata={"Software": None})
    return file.getvalue()
