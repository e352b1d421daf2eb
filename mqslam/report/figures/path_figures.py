"""Charts along the path of a run: errors and drift where there is truth, corrections, speeds, and how sure its poses are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.marginals import PoseCovariances
from mqslam.core import se2
from mqslam.core.statistics import pick_evenly
from mqslam.core.trajectory import Trajectory
from mqslam.evaluation import DriftByLength
from mqslam.report.figures.canvas import BLUE, GREEN, INK, ORANGE, make_chart, put_legend_above, use_plain_log
from mqslam.report.figures.svg import encode_svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Values = NDArray[np.float64]

# the looks of the figures; no result depends on them
_PATH: Final = "distance [m]"
_TURN: Final = "#a8327e"
_MOST: Final = 1200  # points of a curve that are drawn: more cannot be told apart
_ALIKE: Final = 10.0  # curves whose medians differ by a larger factor are drawn on a logarithmic axis
_ROW_IN, _EDGE_IN = 0.5, 0.9  # height of a bar, and of what is around all bars [inch]


class Curve(NamedTuple):
    """A curve over distance: its name, its colour, distances (N,) [m] and values (N,)."""

    name: str
    colour: str
    x: Values
    y: Values


def draw_errors(curves: Sequence[Curve]) -> bytes:
    """Draws how far trajectories are from ground truth over the path."""
    figure, axes = make_chart("error [m]", _PATH)
    _draw_curves(axes, curves)
    if not _are_alike([curve.y for curve in curves]):
        use_plain_log(axes, "y")
    else:
        axes.set_ylim(bottom=0.0)
    put_legend_above(axes)
    return encode_svg(figure)


def draw_drift(rows: Sequence[tuple[str, str, DriftByLength]]) -> bytes:
    """Draws the drift of trajectories by the length of the segments that it is measured on.

    Args:
        rows: name, colour and drift of each trajectory.
    """
    figure, axes = make_chart("translation [%]", "length of segment [m]")
    beside = axes.twinx()
    for name, colour, drift in rows:
        label = f"{name}: translation"
        axes.plot(drift.lengths_m, drift.translation_percent, "-o", color=colour, markersize=4, linewidth=1.4, label=label)
        label = f"{name}: rotation"
        beside.plot(
            drift.lengths_m, drift.rotation_deg_per_100m, "--s", color=colour, markersize=4, linewidth=1.2, label=label
        )
    for one, errors in ((axes, "translation_percent"), (beside, "rotation_deg_per_100m")):
        if not _are_alike([getattr(drift, errors) for _, _, drift in rows]):
            use_plain_log(one, "y")
        else:
            one.set_ylim(bottom=0.0)
    _put_both(axes, beside, "rotation [°/100 m]")
    return encode_svg(figure)


def draw_correction(path: Values, apart_m: Values, turned_rad: Values) -> bytes:
    """Draws by how much optimisation moves and turns poses.

    Args:
        path: (N,) distance driven [m].
        apart_m: (N,) how far a pose lies from where it was [m].
        turned_rad: (N,) by how much it is turned [rad].
    """
    figure, axes = make_chart("moved by [m]", _PATH)
    beside = axes.twinx()
    _draw_curves(axes, [Curve("moved", BLUE, path, apart_m)])
    _draw_curves(beside, [Curve("turned", _TURN, path, np.rad2deg(turned_rad))], "--")
    axes.set_ylim(bottom=0.0)
    _put_both(axes, beside, "turned by [°]")
    return encode_svg(figure)


def draw_speed(track: Trajectory) -> bytes:
    """Draws speed and yaw rate of a trajectory over the path.

    Args:
        track: of two poses or more.
    """
    twists = track.mean_twists(track.stamps_us[:-1], track.stamps_us[1:])
    path = se2.path_lengths(track.poses)[1:]
    figure, axes = make_chart("speed [m/s]", _PATH)
    beside = axes.twinx()
    _draw_curves(axes, [Curve("speed forward", BLUE, path, twists[:, 0])])
    axes.set_ylim(bottom=min(0.0, float(twists[:, 0].min())))
    _draw_curves(beside, [Curve("yaw rate", _TURN, path, np.rad2deg(twists[:, 2]))], "--")
    _put_both(axes, beside, "yaw rate [°/s]")
    return encode_svg(figure)


def draw_sigmas(track: Trajectory, sure: PoseCovariances) -> bytes:
    """Draws how sure poses are, along and across their heading and in it, one sigma each, over the path.

    Args:
        track: the trajectory.
        sure: covariances of some of its poses, one at least.
    """
    sigmas = np.sqrt(np.maximum(np.diagonal(sure.covariances, axis1=1, axis2=2), 0.0))
    path = se2.path_lengths(track.poses)[sure.indices]
    figure, axes = make_chart("position, 1σ [m]", _PATH)
    beside = axes.twinx()
    _draw_curves(axes, [Curve("along", BLUE, path, sigmas[:, 0]), Curve("across", ORANGE, path, sigmas[:, 1])])
    _draw_curves(beside, [Curve("heading", _TURN, path, np.rad2deg(sigmas[:, 2]))], "--")
    axes.set_ylim(bottom=0.0)
    beside.set_ylim(bottom=0.0)
    _put_both(axes, beside, "heading, 1σ [°]")
    return encode_svg(figure)


def draw_contributions(moved_m: Mapping[str, float], turned_rad: Mapping[str, float]) -> bytes:
    """Draws how far each sensor moves the trajectory, and writes how far it turns the end beside it.

    Args:
        moved_m: root mean square [m] by the names of the sensors.
        turned_rad: [rad] by the same names.
    """
    names = list(moved_m)
    figure, axes = make_chart("", "moves the trajectory by [m] (RMS)", _EDGE_IN + _ROW_IN * len(names))
    rows = np.arange(len(names))
    axes.barh(rows, list(moved_m.values()), height=0.5, color=GREEN)
    for row, name in enumerate(names):
        turned = f"{np.rad2deg(turned_rad[name]):+.2g}°".replace("-", "−")
        text = f" {name}: {moved_m[name]:.2g} m, turns the end by {turned}"
        axes.text(0.0, row + 0.29, text, va="bottom", fontsize=10, color=INK)
    axes.set_yticks([])
    axes.set_ylim(-0.5, len(names) - 0.1)
    axes.set_xlim(left=0.0)
    return encode_svg(figure)


def _are_alike(values: Sequence[Values]) -> bool:
    """Returns whether values are of one size, so that a linear axis shows all of them."""
    medians = [float(np.median(some)) for some in values]
    return max(medians) <= _ALIKE * min(medians)


def _draw_curves(axes: Axes, curves: Sequence[Curve], style: str = "-") -> None:
    for curve in curves:
        shown = pick_evenly(len(curve.x), _MOST)
        axes.plot(curve.x[shown], curve.y[shown], style, color=curve.colour, linewidth=1.3, label=curve.name)


def _put_both(axes: Axes, beside: Axes, title: str) -> None:
    """Dresses the axis on the right as the one on the left, and puts one legend for both above the plot."""
    beside.spines[["top", "left", "bottom"]].set_visible(False)
    beside.tick_params(colors=INK, labelsize=10)
    beside.set_ylabel(title, color=INK, fontsize=10)
    box = axes.get_position()
    for one in (axes, beside):
        one.set_position((box.x0, box.y0, box.width - 0.09, box.height - 0.12))
    handles = [handle for one in (axes, beside) for handle in one.get_lines()]
    axes.legend(
        handles=handles, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.2, fontsize=9
    )
