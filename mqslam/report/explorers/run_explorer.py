"""What the interactive part of a run's page shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mqslam.auditing.sizes import TORN_INFLATION
from mqslam.auditing.verdict import VerdictStatus
from mqslam.auditing.windows.windows import WindowAudit
from mqslam.config import AuditConfig
from mqslam.core import se2
from mqslam.core.point_map import PointMap
from mqslam.core.statistics import pick_evenly
from mqslam.core.trajectory import Trajectory
from mqslam.psi.neighbours import find_candidates, sort_into_cells
from mqslam.report.explorers.explorer import (
    FINE,
    TORN,
    UNKNOWN,
    Chart,
    Explorer,
    ExplorerCurve,
    ExplorerPlace,
    Layer,
    Lines,
    PlaceView,
    Points,
    join_lines,
)
from mqslam.report.figures.audit_figures import EXPECTED
from mqslam.report.figures.canvas import BLUE, GREEN, GREY, INK, ORANGE, RED
from mqslam.report.formatting import describe_motion, format_length, format_three_digits
from mqslam.report.inputs.run_report import Report
from mqslam.report.page import section_of

# the looks of the page; no result depends on them
_HALF_SIDE_M = 30.0  # half the side of what is shown of a place
_REACH_M = 43.0  # a circle of this radius holds all of it, whatever its heading
_CELL_M = 10.0  # side of the cells in which points are looked up [m]: a matter of speed only
_SAME_PASS_S = 15.0  # points that were seen earlier or later than this are drawn as those of another pass
_COVERING = 0.2  # ellipses that reach farther, per side of the map, would cover it and are not shown at first
_LARGEST = 0.015  # largest ellipse per side of the map
_ELLIPSES = 150  # most ellipses that are shown, so that a long path is not covered by them
_CORNERS = 24  # corners of an ellipse
_LEAST_INFLATION = 1e-2  # smaller values are drawn as this on a logarithmic axis
_ELLIPSE_COLOUR = "#a8327e"


def explore_run(report: Report, truth: Trajectory | None) -> Explorer:
    """Returns the maps before and after optimisation, psi and inflation over time, and crops of both maps.

    Args:
        report: the run.
        truth: ground truth in the frame of the optimised trajectory, or None.
    """
    before = _make_layer(report.before, ORANGE, report.odometry, report.map_odometry, shown=False)
    after = _make_layer("optimised", BLUE, report.optimised, report.map_optimised, shown=True)
    ellipses, explained = _draw_ellipses(report)
    lines = [ellipses, _draw_loops(report)]
    if truth is not None:
        lines.append(Lines("ground truth", GREEN, truth.poses[:, :2], 4.0, shown=False))
    worst = max(range(len(report.checks)), key=lambda k: _rank_window(report.checks[k]), default=0)
    calm = section_of(report.summary, "verdict").get("status") == VerdictStatus.PASS
    return Explorer(
        layers=(before, after),
        charts=_make_charts(report),
        places=_show_windows(report),
        lines=tuple(one for one in lines if len(one.points)),
        groups=("this pass", "other passes"),
        first=worst,
        first_is=describe_first(calm, bool(report.checks) and report.checks[worst].torn),
        calm=calm,
        explained=(
            "Click a dot or a curve to see that place in both maps, as the sensor sees it, ahead to the right.",
            *explained,
            explain_torn(report.settings),
        ),
    )


def describe_first(calm: bool, torn: bool) -> str:
    """Returns what the place shown first is, on a map that is as it should be; nothing on another.

    Args:
        calm: whether the verdict on the map is pass.
        torn: whether the place is torn.
    """
    if not calm:
        return ""
    return "Largest correction (too few are torn to count)" if torn else "Largest correction (harmless)"


def _rank_window(window: WindowAudit) -> tuple[bool, float]:
    """Ranks the torn windows by how far they are off, and the others by inflation."""
    return window.torn, window.bend.size_m if window.torn else window.bend.inflation


def _make_layer(name: str, colour: str, track: Trajectory, pointmap: PointMap, *, shown: bool) -> Layer:
    values = {"time": pointmap.times, "psi": pointmap.psi, "intensity": pointmap.intensities}
    ink = None if shown else colour
    seconds = track.seconds(int(track.stamps_us[0]))
    return Layer(name, colour, seconds, track.poses[:, :2], pointmap.points, values, shown, ink)


def _draw_loops(report: Report) -> Lines:
    ends = report.optimised.poses[report.loops, :2]
    return Lines(f"loop closures ({len(ends)})", GREEN, join_lines(list(ends)), 2.0)


def _draw_ellipses(report: Report) -> tuple[Lines, tuple[str, ...]]:
    """Returns 3-sigma ellipses of the positions, enlarged where they would not be seen, and what to tell the reader."""
    sure = report.covariances
    picked = pick_evenly(len(sure.indices), _ELLIPSES)
    poses, covariances = report.optimised.poses[sure.indices[picked]], sure.covariances[picked]
    round_trip = np.linspace(0.0, 2.0 * np.pi, _CORNERS + 1)
    circle = np.column_stack([np.cos(round_trip), np.sin(round_trip)])
    shapes, largest = [], 0.0
    for pose, covariance in zip(poses, covariances, strict=True):
        values, vectors = np.linalg.eigh(se2.rotate_covariance(covariance, float(pose[2]))[:2, :2])
        axes = 3.0 * np.sqrt(np.maximum(values, 0.0))
        largest = max(largest, float(axes.max()))
        shapes.append((circle * axes) @ vectors.T)
    side = float(np.ptp(report.optimised.poses[:, :2], axis=0).max())
    factor = _round_down(_LARGEST * side / largest) if largest > 0.0 else 1.0
    drawn = join_lines([pose[:2] + factor * shape for pose, shape in zip(poses, shapes, strict=True)])
    name = "3σ ellipses" if factor == 1.0 else f"3σ ellipses, {factor:g} times"
    explained = []
    if sure.failure:
        explained.append(f"No ellipses are shown: the covariances of the poses are not known ({sure.failure}).")
    if shapes:
        explained.append(
            f"The largest 3σ ellipse reaches {format_length(largest)} from its middle, with the first pose held fixed."
        )
        if section_of(report.summary, "last_pose").get("drift_is_prior"):
            explained.append(
                "Drift that both directions of time have in common cannot be measured in one pass; a prior stands for it."
            )
    shown = len(shapes) > 0 and largest <= max(_COVERING * side, 1.0)
    return Lines(name, _ELLIPSE_COLOUR, drawn, 1.2, shown), tuple(explained)


def _round_down(factor: float) -> float:
    """Returns the largest of 1, 2, 5, 10, 20, ... that is no more than a factor; 1 at least."""
    steps = (n * 10.0**k for k in range(6) for n in (1, 2, 5))
    return max((step for step in steps if step <= factor), default=1.0)


def _make_charts(report: Report) -> tuple[Chart, ...]:
    scores, checks = report.scores, report.checks
    times = 0.5 * (scores.t0 + scores.t1)
    points = np.maximum(scores.points, 1)
    curves = []
    if np.isfinite(scores.psi_odometry).any():
        curves.append(ExplorerCurve("ψ under odometry", ORANGE, times, scores.psi_odometry / points))
    if np.isfinite(scores.psi_minimum).any():
        curves.append(ExplorerCurve("ψ at its minimum", BLUE, times, scores.psi_minimum / points))
    charts = [Chart("ψ per point of a scan", tuple(curves))] if curves else []
    if checks:
        charts.append(chart_inflation("inflation", checks, BLUE))
    return tuple(charts)


def chart_inflation(name: str, windows: Sequence[WindowAudit], colour: str) -> Chart:
    """Returns the inflation of windows over time: torn ones are red triangles, undecided ones grey squares.

    Args:
        name: name of those that are neither.
        windows: the windows.
        colour: colour of those that are neither.
    """
    undecided = [w for w in windows if w.undecided is not None]
    torn = [w for w in windows if w.torn]
    fine = [w for w in windows if not w.torn and w.undecided is None]
    kinds = (
        (fine, colour, name, FINE),
        (torn, RED, f"{name}: torn", TORN),
        (undecided, GREY, f"{name}: undecided", UNKNOWN),
    )
    curves = []
    for shown, shade, title, mark in kinds:
        if shown:
            times = np.array([0.5 * (w.t0 + w.t1) for w in shown])
            values = np.maximum([w.bend.inflation for w in shown], _LEAST_INFLATION)
            curves.append(ExplorerCurve(title, shade, times, values, dots=True, mark=mark))
    return Chart("inflation", tuple(curves), list_levels(), log=True)


def list_levels() -> tuple[tuple[str, float, str], ...]:
    """Returns what inflation is to be held against: name, value and colour."""
    return (f"threshold {TORN_INFLATION:.1f}", TORN_INFLATION, RED), (f"expected median {EXPECTED:.2f}", EXPECTED, INK)


def explain_torn(settings: AuditConfig) -> str:
    """Explains when a window is torn, for those who see dots beyond the threshold."""
    return (
        f"A window is torn where its inflation is above {TORN_INFLATION:.1f} and its correction moves its "
        f"points by more than {format_length(settings.bend_m)}. Torn places are red triangles, "
        "the others blue dots, and those of which nothing could be decided grey squares."
    )


def _describe_window(window: WindowAudit) -> tuple[str, str]:
    """Returns title and text of a window."""
    torn = "torn: " if window.torn else "not torn: "
    if window.undecided is not None:
        torn = f"undecided, since {window.undecided}: "
    return (
        f"{window.t0:.1f} s to {window.t1:.1f} s, inflation {format_three_digits(window.bend.inflation)}",
        f"{torn}best with its end moved {describe_motion(window.bend.correction)}, which moves its points by "
        f"{format_length(window.bend.size_m)}; {100.0 * window.bend.matched:.0f} % of them are seen twice",
    )


def _show_windows(report: Report) -> tuple[ExplorerPlace, ...]:
    """Returns what is shown of every window when it is clicked."""
    if not report.checks:
        return ()
    shown = [
        (report.before, report.map_odometry, report.odometry),
        ("optimised", report.map_optimised, report.optimised),
    ]
    views = [_view_windows(name, pointmap, track, report.checks) for name, pointmap, track in shown]
    return tuple(
        ExplorerPlace(window.t0, window.t1, *_describe_window(window), window.torn, both, window.undecided is not None)
        for window, both in zip(report.checks, zip(*views, strict=True), strict=True)
    )


def _view_windows(name: str, pointmap: PointMap, track: Trajectory, windows: Sequence[WindowAudit]) -> list[PlaceView]:
    """Returns the map around windows, each seen from the sensor at its middle: this pass and the others."""
    poses = [track.poses[min((window.begin + window.end) // 2, len(track) - 1)] for window in windows]
    parts: list[list[tuple[Points, Points]]] = [[] for _ in windows]
    centres = np.array([pose[:2] for pose in poses])
    for block in pointmap.blocks():
        lists = find_candidates(sort_into_cells(block.points, _CELL_M), centres, _REACH_M)
        around = np.split(lists.indices, lists.offsets[1:-1])
        for window, pose, indices, part in zip(windows, poses, around, parts, strict=True):
            near = np.sort(indices)
            seen = se2.transform(se2.inverse(pose), block.points[near])
            inside = (np.abs(seen[:, 0]) <= _HALF_SIDE_M) & (np.abs(seen[:, 1]) <= _HALF_SIDE_M)
            own = np.abs(block.times[near] - 0.5 * (window.t0 + window.t1)) <= _SAME_PASS_S
            part.append((seen[inside & own], seen[inside & ~own]))
    nothing = (np.empty((0, 2)), np.empty((0, 2)))
    joined = [tuple(np.concatenate(group) for group in zip(nothing, *part, strict=True)) for part in parts]
    return [PlaceView(name, (own, others), (BLUE, ORANGE)) for own, others in joined]
