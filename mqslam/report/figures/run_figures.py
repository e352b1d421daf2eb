"""Figures of a run's page."""

from __future__ import annotations

import numpy as np

from mqslam.core.point_map import PointMap
from mqslam.core.trajectory import Trajectory
from mqslam.report.figures.canvas import (
    BLUE,
    GREEN,
    INK,
    MAP_SHAPE,
    ORANGE,
    OUTERMOST,
    PATH_SHAPE,
    RED,
    count_points,
    encode_png,
    find_common_view,
    lay_ink,
    make_chart,
    make_world,
    put_legend_above,
)
from mqslam.report.figures.svg import encode_svg
from mqslam.report.inputs.run_report import ScanScores

ODOMETRY_COLOUR, OPTIMISED_COLOUR, TRUTH_COLOUR = ORANGE, BLUE, GREEN


def draw_maps(
    maps: tuple[PointMap, PointMap], paths: tuple[Trajectory, Trajectory], colours: tuple[str, str]
) -> tuple[bytes, bytes]:
    """Draws two maps by the density of their points, on one extent, one scale and one shade of ink per count.

    Args:
        maps: the maps.
        paths: the trajectories they were rendered under.
        colours: colours of the trajectories.
    """
    view = find_common_view([*(m.points for m in maps), *(p.poses[:, :2] for p in paths)], MAP_SHAPE, OUTERMOST)
    counts, well_seen = count_points(make_world(view)[1], view, [m.points for m in maps])
    images = []
    for count, path, colour in zip(counts, paths, colours, strict=True):
        figure, axes = make_world(view)
        lay_ink(axes, view, count, well_seen)
        axes.plot(path.poses[:, 0], path.poses[:, 1], color=colour, linewidth=1.4)
        axes.plot(path.poses[0, 0], path.poses[0, 1], "o", color=colour, markersize=5)
        images.append(encode_png(figure))
    return images[0], images[1]


def draw_trajectories(odometry: Trajectory, optimised: Trajectory, truth: Trajectory | None, before: str) -> bytes:
    """Draws the trajectories from above.

    Args:
        odometry: trajectory before optimisation.
        optimised: trajectory after it.
        truth: ground truth in their frame, or None.
        before: name of the trajectory before optimisation.
    """
    drawn = [p for p in (odometry, optimised, truth) if p is not None]
    view = find_common_view([p.poses[:, :2] for p in drawn], PATH_SHAPE)
    figure, axes = make_world(view)
    if truth is not None:
        axes.plot(truth.poses[:, 0], truth.poses[:, 1], color=TRUTH_COLOUR, linewidth=4, alpha=0.4, label="ground truth")
    axes.plot(odometry.poses[:, 0], odometry.poses[:, 1], color=ODOMETRY_COLOUR, linewidth=1.4, label=before)
    axes.plot(optimised.poses[:, 0], optimised.poses[:, 1], color=OPTIMISED_COLOUR, linewidth=1.4, label="optimised")
    axes.plot(optimised.poses[0, 0], optimised.poses[0, 1], "o", color=INK, markersize=5, label="start")
    axes.legend(frameon=False, loc="best")
    return encode_png(figure)


def draw_psi(scores: ScanScores) -> bytes:
    """Draws psi per point of every scan over time, at its minimum and under odometry."""
    figure, axes = make_chart("ψ per point")
    time = 0.5 * (scores.t0 + scores.t1)
    points = np.maximum(scores.points, 1)
    if np.isfinite(scores.psi_odometry).any():
        axes.plot(time, scores.psi_odometry / points, color=ODOMETRY_COLOUR, linewidth=1.2, label="under odometry")
    axes.plot(time, scores.psi_minimum / points, color=OPTIMISED_COLOUR, linewidth=1.2, label="at its minimum")
    unused = time[np.array([s != "converged" for s in scores.status], dtype=np.bool_)]
    if len(unused):
        height = np.full(len(unused), 0.02)
        label = f"no measurement ({len(unused)})"
        axes.plot(unused, height, "|", color=RED, markersize=9, transform=axes.get_xaxis_transform(), label=label)
    axes.set_ylim(bottom=0.0)
    put_legend_above(axes)
    return encode_svg(figure)


def draw_matched(scores: ScanScores) -> bytes:
    """Draws the share of every scan's points that have a neighbour, over time."""
    figure, axes = make_chart("matched points [%]")
    time = 0.5 * (scores.t0 + scores.t1)
    axes.fill_between(time, 100.0 * scores.matched, color=OPTIMISED_COLOUR, alpha=0.15, linewidth=0)
    axes.plot(time, 100.0 * scores.matched, color=OPTIMISED_COLOUR, linewidth=1.2)
    axes.set_ylim(0.0, 100.0)
    return encode_svg(figure)
