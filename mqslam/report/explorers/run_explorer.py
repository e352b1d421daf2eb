"""What the interactive part of a run's report shows."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from mqslam.audit.windows import WindowAudit, torn_threshold
from mqslam.config import AuditConfig
from mqslam.core import se2
from mqslam.core.point_map import PointMap
from mqslam.core.trajectory import Trajectory
from mqslam.report.audit_figures import EXPECTED
from mqslam.report.canvas import BLUE, GREEN, INK, ORANGE, RED
from mqslam.report.content import Report
from mqslam.report.explorers.explorer import Chart, Curve, Explorer, Layer, Lines, Place, Points, View, parted
from mqslam.report.spots import direction, length, three

_HALF_SIDE_M = 30.0  # of what is shown of a place
_TILE_M = 40.0
_SAME_PASS_S = 15.0  # points seen sooner or later are another pass's
_COVERING = 0.2  # ellipses that reach farther, per side of the map, would cover it and are not shown at first
_LARGEST = 0.015  # largest ellipse per side of the map
_ROUND = 24  # corners of an ellipse


def run_explorer(report: Report, truth: Trajectory | None) -> Explorer:
    """The maps before and after optimisation, psi and inflation over time, and crops of both maps.

    Args:
        report: the run.
        truth: ground truth in the frame of the optimised trajectory, or None.
    """
    before = _layer(report.before, ORANGE, report.odometry, report.map_odometry, shown=False)
    after = _layer("optimised", BLUE, report.optimised, report.map_optimised, shown=True)
    ellipses, said = _ellipses(report)
    lines = [ellipses, _loops(report)]
    if truth is not None:
        lines.append(Lines("ground truth", GREEN, truth.poses[:, :2], 4.0, shown=False))
    worst = max(range(len(report.checks)), key=lambda k: report.checks[k].bend.inflation, default=0)
    return Explorer(
        layers=(before, after),
        charts=_charts(report),
        places=_places(report),
        lines=tuple(one for one in lines if len(one.points)),
        groups=("this pass", "other passes"),
        first=worst,
        explained=said + torn_means(report.settings) + "A click on a dot or a curve shows that place in both maps, as the "
        "sensor sees it, ahead to the right.",
    )


def _layer(name: str, colour: str, track: Trajectory, pointmap: PointMap, *, shown: bool) -> Layer:
    values = {"time": pointmap.times, "psi": pointmap.psi, "intensity": pointmap.intensities}
    ink = None if shown else colour
    seconds = track.seconds(int(track.stamps_us[0]))
    return Layer(name, colour, seconds, track.poses[:, :2], pointmap.points, values, shown, ink)


def _loops(report: Report) -> Lines:
    ends = report.optimised.poses[report.loops, :2]
    return Lines(f"loop closures ({len(ends)})", GREEN, parted(list(ends)), 2.0)


def _ellipses(report: Report) -> tuple[Lines, str]:
    """3-sigma ellipses of the positions, drawn larger where they would not be seen, and what to say of that."""
    sure = report.sure
    poses = report.optimised.poses[sure.indices]
    round_trip = np.linspace(0.0, 2.0 * np.pi, _ROUND + 1)
    circle = np.column_stack([np.cos(round_trip), np.sin(round_trip)])
    shapes, largest = [], 0.0
    for pose, covariance in zip(poses, sure.covariances, strict=True):
        values, vectors = np.linalg.eigh(se2.rotate_covariance(covariance, float(pose[2]))[:2, :2])
        axes = 3.0 * np.sqrt(np.maximum(values, 0.0))
        largest = max(largest, float(axes.max()))
        shapes.append((circle * axes) @ vectors.T)
    side = float(np.ptp(report.optimised.poses[:, :2], axis=0).max())
    factor = _rounded(_LARGEST * side / largest) if largest > 0.0 else 1.0
    drawn = parted([pose[:2] + factor * shape for pose, shape in zip(poses, shapes, strict=True)])
    name = "3σ ellipses" if factor == 1.0 else f"3σ ellipses, {factor:g} times"
    said = f"No ellipses are shown: the covariances of the poses are not known ({sure.failure}). " if sure.failure else ""
    if shapes:
        said = f"The largest 3σ ellipse reaches {length(largest)} from its middle, the first pose held. "
    return Lines(name, "#a8327e", drawn, 1.2, shown=len(shapes) > 0 and largest <= max(_COVERING * side, 1.0)), said


def _rounded(factor: float) -> float:
    """The largest of 1, 2, 5, 10, 20, ... that is no more than a factor; 1 at least."""
    steps = (n * 10.0**k for k in range(6) for n in (1, 2, 5))
    return max((step for step in steps if step <= factor), default=1.0)


def _charts(report: Report) -> tuple[Chart, ...]:
    windows, checks = report.windows, report.checks
    times = 0.5 * (windows.t0 + windows.t1)
    points = np.maximum(windows.points, 1)
    curves = []
    if np.isfinite(windows.psi_odometry).any():
        curves.append(Curve("ψ under odometry", ORANGE, times, windows.psi_odometry / points))
    curves.append(Curve("ψ at its minimum", BLUE, times, windows.psi_minimum / points))
    charts = [Chart("ψ per point of a window", tuple(curves))]
    if checks:
        charts.append(inflation_chart([("inflation", checks, BLUE)], torn_threshold(report.settings)))
    return tuple(charts)


def inflation_chart(rows: list[tuple[str, tuple[WindowAudit, ...], str]], threshold: float) -> Chart:
    """Inflation of the windows of every row (name, windows, colour) over time; of one row alone the torn ones are red."""
    curves = []
    for name, windows, colour in rows:
        alone = len(rows) == 1
        fine, torn = [w for w in windows if not (alone and w.torn)], [w for w in windows if alone and w.torn]
        for shown, shade, said in ((fine, colour, name), (torn, RED, f"{name}: torn")):
            if shown:
                times = np.array([0.5 * (w.t0 + w.t1) for w in shown])
                values = np.maximum([w.bend.inflation for w in shown], 1e-2)
                curves.append(Curve(said, shade, times, values, dots=True))
    levels = ((f"threshold {threshold:.1f}", threshold, RED), (f"expected median {EXPECTED:.2f}", EXPECTED, INK))
    return Chart("inflation", tuple(curves), levels, log=True)


def torn_means(settings: AuditConfig) -> str:
    """When a window is torn, for those who see dots beyond the threshold."""
    return (
        f"A window is torn where its inflation is above {torn_threshold(settings):.1f} and its correction moves its "
        f"points by more than {length(settings.bend_m)}. "
    )


def window_text(window: WindowAudit) -> tuple[str, str]:
    """Title and text of a window."""
    torn = "torn: " if window.torn else "not torn: "
    return (
        f"{window.t0:.1f} s to {window.t1:.1f} s, inflation {three(window.bend.inflation)}",
        f"{torn}best with its end moved {direction(window.bend.correction)}, which moves its points by "
        f"{length(window.bend.size_m)}; {100.0 * window.bend.matched:.0f} % of them are seen twice",
    )


def _places(report: Report) -> tuple[Place, ...]:
    if not report.checks:
        return ()
    maps = [
        (report.before, report.map_odometry, report.odometry, _Tiles(report.map_odometry.points)),
        ("optimised", report.map_optimised, report.optimised, _Tiles(report.map_optimised.points)),
    ]
    places = []
    for window in report.checks:
        views = tuple(_view(name, pointmap, track, tiles, window) for name, pointmap, track, tiles in maps)
        places.append(Place(window.t0, window.t1, *window_text(window), window.torn, views))
    return tuple(places)


def _view(name: str, pointmap: PointMap, track: Trajectory, tiles: _Tiles, window: WindowAudit) -> View:
    """The map around a window, seen from the sensor at its middle: this pass and the others."""
    pose = track.poses[min((window.begin + window.end) // 2, len(track) - 1)]
    near = tiles.near(pose[:2])
    seen = se2.transform(se2.inverse(pose), pointmap.points[near])
    inside = np.abs(seen).max(axis=1) <= _HALF_SIDE_M
    own = np.abs(pointmap.times[near] - 0.5 * (window.t0 + window.t1)) <= _SAME_PASS_S
    return View(name, (seen[inside & own], seen[inside & ~own]), (BLUE, ORANGE))


class _Tiles:
    """Points (N, 2) by the tile they lie on, so that those near a place are found without looking at all."""

    def __init__(self, points: Points) -> None:
        self._low = np.floor(points.min(axis=0) / _TILE_M).astype(np.int64) - 1 if len(points) else np.zeros(2, np.int64)
        tile = np.floor(points / _TILE_M).astype(np.int64) - self._low
        self._rows = int(tile[:, 1].max(initial=0)) + 2
        numbers = tile[:, 0] * self._rows + tile[:, 1]
        self._order = np.argsort(numbers, kind="stable")
        self._sorted = numbers[self._order]

    def near(self, position: NDArray[np.float64]) -> NDArray[np.int64]:
        """Indices of all points within a tile's side of a position (2,), and of some beyond."""
        column, row = np.floor(np.asarray(position) / _TILE_M).astype(np.int64) - self._low
        tiles = [(column + i) * self._rows + row + k for i, k in itertools.product((-1, 0, 1), repeat=2) if row + k >= 0]
        begins, ends = np.searchsorted(self._sorted, tiles), np.searchsorted(self._sorted, tiles, side="right")
        return np.sort(np.concatenate([self._order[a:b] for a, b in zip(begins, ends, strict=True)]))
