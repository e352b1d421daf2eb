"""Makes the page of a run: its verdict, its map and trajectory before and after optimisation, charts and numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial import cKDTree

from mqslam.auditing.table import apply_tolerance
from mqslam.auditing.verdict import VerdictStatus
from mqslam.auditing.windows.windows import WindowAudit
from mqslam.config import dump_yaml, set_doppler_beta
from mqslam.core import se2
from mqslam.core.measurement import Status
from mqslam.core.point_map import PointMap
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import describe_last_pose, list_sensor_notes
from mqslam.evaluation import align_positions, measure_drift_by_length, trace_errors
from mqslam.mapping.render import select_moving
from mqslam.report.canvas import (
    BLUE,
    GREEN,
    INK,
    ORANGE,
    OUTERMOST,
    PATH_SHAPE,
    PURPLE,
    RED,
    Chart,
    Curve,
    Drawing,
    Points,
    draw_chart,
    draw_ellipses,
    draw_world,
    join_lines,
    over,
)
from mqslam.report.explorer import MOST_CROPPED, Layer, Place, chart_inflation, explain_torn, explore, values_of
from mqslam.report.heat_map import draw_heat_map, explain_heat_map
from mqslam.report.page import Explorer, Figure, Page, Section, tabulate_tests
from mqslam.report.spots import rank_spot, spot_of_window
from mqslam.report.words import (
    ABSENT,
    format_change,
    format_length,
    format_matched,
    format_value,
    label_value,
    list_facts,
    list_values,
    part_of,
)
from mqslam.solution import Run

# the looks of the page; no result depends on them
_HALF_SIDE_M = 30.0  # half the side of the close view of a place
_REACH_M = 43.0  # a circle of this radius holds the close view at any heading
_SAME_TIME_S = 15.0  # points seen longer than this before or after a window's middle time have another colour
_SAME_PATH_M: Final = 1e-3  # positions that differ by less look the same in a picture
_SHORTEST_STEP: Final = 0.5  # speeds are shown over at least this share of the median time between scans
_ALIKE: Final = 10.0  # curves whose medians differ by a larger factor are drawn on a logarithmic axis
_DISTANCE: Final = "distance [m]"
_GROUPS: Final = {
    "dataset": "Recording",
    "factors": "Graph factors",
    "evaluation": "Against ground truth",
    "runtime_s": "Run time",
    "mount": "Radar on the vehicle",
    "gyroscope": "Gyroscope",
    "gnss": "GNSS",
    "chirps": "Velocities by chirps",
}


def write_run_page(folder: Path, run: Run, recording: Recording, summary: Mapping[str, Any]) -> list[str]:
    """Writes a run's page into an existing folder; the page needs no network.

    Args:
        folder: the folder.
        run: the finished run.
        recording: the recording that the run processed.
        summary: content of summary.json; values that are absent or None are shown as not available.

    Returns:
        A message for each part that could not be made, with the reason; the page shows them, too.

    Raises:
        OutputError: the file cannot be written.
    """
    facts = list_facts(
        summary,
        front_end=summary.get("frontend"),
        last_pose=describe_last_pose(summary.get("last_pose")),
        ground_truth=_describe_errors(part_of(summary, "evaluation")),
    )
    notes = (*recording.notes, *list_sensor_notes({**summary, "psi": None}))  # the whole map's psi may prefer a worse map
    settings = dump_yaml(set_doppler_beta(run.config, run.doppler_beta))
    page = Page(recording.path.resolve().name, summary, settings, facts=facts, notes=notes)
    truth = _align_truth(run.optimised, recording.ground_truth)
    page.add_lead("the map of the verdict", lambda: _show_verdict(run))
    page.add("the tests", lambda: tabulate_tests(summary))
    page.add_explorer(
        lambda: explore_run(run, summary, truth),
        [
            ("the pictures of the maps", lambda: _show_maps(run, recording.sensor_name)),
            ("the pictures of the trajectory", lambda: _show_trajectories(run, truth)),
        ],
    )
    page.add("the charts along the path", lambda: chart_path(run, recording.ground_truth, recording.left_out))
    page.add("the tables", lambda: _list_numbers(run, recording, summary))
    return page.write(folder)


def _stood_still(run: Run) -> bool:
    """Returns whether the sensor never moved, so that the maps hold one scan only."""
    moved = select_moving(run.optimised.poses)
    return len(moved) > 1 and moved.sum() == 1


def _left_as_it_was(run: Run) -> bool:
    """Returns whether optimisation moved no position by `_SAME_PATH_M` or more."""
    a, b = run.odometry, run.optimised
    return bool(np.array_equal(a.stamps_us, b.stamps_us) and np.all(np.abs(a.poses - b.poses)[:, :2] < _SAME_PATH_M))


def _describe_errors(errors: Mapping[str, Any]) -> str:
    """Returns the errors against ground truth, given as in summary.json, in words; an empty text for an empty mapping."""
    drift = f", drift {format_value(errors['drift_percent'])} %" if errors.get("drift_percent") is not None else ""
    return f"{format_value(errors.get('ate_rmse_m'), ' m')} off (ATE, RMSE){drift}; no part of the verdict" if errors else ""


def _show_verdict(run: Run) -> Section:
    """Returns the heat map of the optimised map."""
    picture = draw_heat_map(run.map_optimised.points, run.optimised.poses[:, :2], run.checked, opaque=False)
    caption = explain_heat_map(run.checks) if run.checked else "nothing has judged the map"
    return Section("", figures=[Figure(picture, "Map", caption)])


def _show_maps(run: Run, sensor: str) -> Section:
    notes = [
        "Every return of the run, darker where more of them lie; both maps have the same extent and scale, and "
        f"up to {100.0 * OUTERMOST:g} % of the points may lie beyond each edge."
    ]
    if _stood_still(run):
        notes = [
            f"The {sensor} stood still, so the optimised map holds the returns of one scan only. "
            "No other scan can match them, and ψ, which charges every point without a match, is not judged."
        ]
    if _left_as_it_was(run):
        notes.append(
            "Optimisation left the trajectory as it was, so both maps are the same: "
            f"nothing in the graph contradicted {run.before}."
        )
    shown = (
        (f"Under {run.before}", run.map_odometry, run.odometry, ORANGE),
        ("Optimised", run.map_optimised, run.optimised, BLUE),
    )
    pictures = draw_maps([(pointmap, track, colour) for _, pointmap, track, colour in shown])
    figures = [
        Figure(picture, name, f"{len(pointmap):,} points")
        for picture, (name, pointmap, _, _) in zip(pictures, shown, strict=True)
    ]
    return Section("Maps", notes, figures=figures)


def draw_maps(maps: Sequence[tuple[PointMap, Trajectory, str]]) -> list[bytes]:
    """Draws the density of maps, each with its trajectory in a colour, as PNG files that share their extent and scale."""
    drawings = []
    for pointmap, track, colour in maps:
        path = track.poses[:, :2]
        drawings.append(Drawing([(pointmap.points, INK)], [Curve("", colour, path), Curve("", colour, path[:1], "o", 5.0)]))
    return draw_world(drawings)


def _show_trajectories(run: Run, truth: Trajectory | None) -> Section:
    curves = [
        Curve(run.before, ORANGE, run.odometry.poses[:, :2]),
        Curve("optimised", BLUE, run.optimised.poses[:, :2]),
        Curve("start", INK, run.optimised.poses[:1, :2], "o", 5.0),
    ]
    if truth is not None:
        curves.insert(0, Curve("ground truth", GREEN, truth.poses[:, :2], width=4.0, alpha=0.4))
    caption = "ground truth aligned with the optimised trajectory by the best rigid motion" if truth is not None else ""
    trajectory = Figure(draw_world([Drawing((), curves)], PATH_SHAPE)[0], "Trajectory", caption)
    if not run.measurements:
        return Section("Trajectory", figures=[trajectory])
    counts = Counter(m.status.value for m in run.measurements).most_common()
    motions = f"{len(run.measurements):,} motions between {len(run.measurements) + 1:,} scans"
    statuses = f"{motions}: {', '.join(f'{n:,} {status}' for status, n in counts)}"
    times = _middles(run)
    unused = times[[m.status is not Status.CONVERGED for m in run.measurements]]
    marks = Curve(f"no measurement ({len(unused)})", RED, over(unused, np.zeros(len(unused))), "|", 9.0)
    psi = Chart("ψ per point", (*_trace_psi(run), *([marks] if len(unused) else [])))
    matched = over(times, [100.0 * m.matched for m in run.measurements])
    charts = [
        Figure(draw_chart(psi), "ψ per scan", statuses),
        Figure(
            draw_chart(Chart("matched points [%]", (Curve("", BLUE, matched),), top=100.0)),
            "Matched share",
            "points with a neighbour that takes part in the score",
        ),
    ]
    return Section("Trajectory and scans", figures=[trajectory], stacked=charts)


def _middles(run: Run) -> se2.Array:
    """Returns the time (W,) [s since the recording's start] at the middle of each of the W measurements."""
    return np.array([0.5 * (m.t0 + m.t1) for m in run.measurements])


def _trace_psi(run: Run) -> list[Curve]:
    """Returns curves over time of psi per point of each scan: (1) under odometry, (2) at its minimum.

    A curve without any finite value is left out.
    """
    points = np.maximum([m.points for m in run.measurements], 1)
    known = (
        ("under odometry", ORANGE, np.array([m.psi_odometry for m in run.measurements])),
        ("at its minimum", BLUE, np.array([m.psi for m in run.measurements])),
    )
    curves = [(name, colour, psi / points) for name, colour, psi in known if np.isfinite(psi).any()]
    return [Curve(f"ψ {name}", colour, over(_middles(run), values)) for name, colour, values in curves]


def _align_truth(optimised: Trajectory, truth: Trajectory | None) -> Trajectory | None:
    """Returns the ground truth in the frame of the optimised trajectory; None if it is missing or cannot be aligned."""
    motion = None if truth is None else align_positions(optimised, truth)
    if truth is None or motion is None:
        return None
    return Trajectory(truth.stamps_us, se2.compose(se2.inverse(motion), truth.poses))


def explore_run(run: Run, summary: Mapping[str, Any], truth: Trajectory | None) -> Explorer | None:
    """Returns the interactive map of a run: maps before and after optimisation, charts of psi and inflation over time.

    A click on a window shows it in close view under both trajectories. The result is None if the maps hold no points.

    Args:
        run: the run.
        summary: content of summary.json.
        truth: ground truth in the frame of the optimised trajectory; None without ground truth.
    """
    before = _make_layer(run.before, ORANGE, run.odometry, run.map_odometry, shown=False)
    after = _make_layer("optimised", BLUE, run.optimised, run.map_optimised, shown=True)
    ellipses, explained = _draw_ellipses(run, summary)
    ends = [run.optimised.poses[[loop.earlier, loop.later], :2] for loop in run.loops]
    lines = [ellipses, Curve(f"loop closures ({len(ends)})", GREEN, join_lines(ends), width=2.0)]
    if truth is not None:
        lines.append(Curve("ground truth", GREEN, truth.poses[:, :2], width=4.0, shown=False))
    psi = _trace_psi(run)
    charts = [Chart("ψ per point of a scan", tuple(psi))] if psi else []
    if run.checks:
        charts.append(chart_inflation(run.checks))
    return explore(
        (before, after),
        charts,
        _show_windows(run),
        (
            "Click a dot or a curve to see that place in both maps, as the sensor sees it, ahead to the right.",
            *explained,
            explain_torn(apply_tolerance(run.config.audit, run.config.verdict)),
        ),
        lines=lines,
        groups=(f"seen within {_SAME_TIME_S:g} s", "seen earlier or later"),
        first=max(range(len(run.checks)), key=lambda k: rank_spot(spot_of_window(run.checks[k])), default=0),
        is_calm=part_of(summary, "verdict").get("status") == VerdictStatus.PASS,
    )


def _make_layer(name: str, colour: str, track: Trajectory, pointmap: PointMap, *, shown: bool) -> Layer:
    times = track.seconds(int(track.stamps_us[0]))
    ink = None if shown else colour
    return Layer(name, colour, times, track.poses[:, :2], pointmap.points, values_of(pointmap), shown, ink)


def _draw_ellipses(run: Run, summary: Mapping[str, Any]) -> tuple[Curve, list[str]]:
    """Returns a curve of the positions' 3-sigma ellipses, and lines of text about the ellipses.

    The ellipses would cover the path, so they are hidden until their name in the legend is clicked.
    """
    sure = run.covariances
    poses = run.optimised.poses[sure.indices]
    turned = [se2.rotate_covariance(own, yaw) for own, yaw in zip(sure.covariances, poses[:, 2].tolist(), strict=True)]
    shown = [run.map_optimised.points, run.optimised.poses[:, :2]]
    curve, largest = draw_ellipses(poses[:, :2], np.array(turned).reshape(-1, 3, 3), shown)
    explained = []
    if sure.failure:
        explained.append(f"No ellipses are shown: the covariances of the poses are not known ({sure.failure}).")
    if len(poses):
        explained.append(
            f"The legend shows the 3σ ellipses of the positions, with the first pose held fixed; the largest reaches "
            f"{format_length(largest)} from its centre."
        )
        explained += part_of(summary, "range_scale").get("statements", [])
    return replace(curve, shown=False), explained


def _show_windows(run: Run) -> list[Place]:
    """Returns for each judged window the text and the close views that a click on the window shows."""
    maps = [(run.before, run.map_odometry, run.odometry), ("optimised", run.map_optimised, run.optimised)]
    if _left_as_it_was(run):
        del maps[0]  # both views would be the same
    views = [(name, _crop_windows(pointmap, track, run.checks)) for name, pointmap, track in maps]
    places = []
    for k, spot in enumerate(map(spot_of_window, run.checks)):
        shown = [(name, crops[k], (BLUE, ORANGE)) for name, crops in views]
        places.append(Place(spot.t0, spot.t1, spot.title, spot.text, shown, spot.torn, spot.undecided is not None))
    return places


def _crop_windows(pointmap: PointMap, track: Trajectory, windows: Sequence[WindowAudit]) -> list[list[Points]]:
    """Returns for each window two arrays of points (M, 2) [m] around it: points seen at the time of the window, and others.

    The first array holds points seen within `_SAME_TIME_S` of the window's middle. All are in the frame of the sensor at the
    window's middle scan. If the page cannot show all points, the map is thinned evenly, so that the crops of a lidar,
    whose windows all show the same rooms, do not fill the memory.
    """
    poses = [track.poses[min((window.begin + window.end) // 2, len(track) - 1)] for window in windows]
    crops: list[list[list[Points]]] = [[[np.empty((0, 2))], [np.empty((0, 2))]] for _ in windows]
    step = max(1, _count_cropped(pointmap, poses) // MOST_CROPPED)
    for block in pointmap.blocks() if windows else ():
        points, times = block.points[::step], block.times[::step]
        tree = cKDTree(points)
        for window, pose, crop in zip(windows, poses, crops, strict=True):
            near = tree.query_ball_point(pose[:2], _REACH_M, return_sorted=True)
            seen = se2.transform(se2.inverse(pose), points[near])
            inside = np.abs(seen).max(axis=1, initial=0.0) <= _HALF_SIDE_M
            own = np.abs(times[near] - 0.5 * (window.t0 + window.t1)) <= _SAME_TIME_S
            crop[0].append(seen[inside & own])
            crop[1].append(seen[inside & ~own])
    return [[np.concatenate(group) for group in crop] for crop in crops]


def _count_cropped(pointmap: PointMap, poses: Sequence[se2.Array]) -> int:
    """Returns how many points of a map lie within `_REACH_M` of poses (3,) [m, m, rad], summed over the poses."""
    if not poses:
        return 0
    counts = (
        cKDTree(block.points).query_ball_point(np.array(poses)[:, :2], _REACH_M, return_length=True)
        for block in pointmap.blocks()
    )
    return int(sum(count.sum() for count in counts))


def chart_path(run: Run, truth: Trajectory | None, left_out: int = 0) -> Section | None:
    """Returns the charts over the length of the path; None for a run of a single pose.

    Args:
        run: the run.
        truth: ground truth in any fixed frame; None without ground truth.
        left_out: number of scans that are left out because the sensor had hardly moved.
    """
    if len(run.optimised) < 2:
        return None
    charts = [*_chart_truth(run, truth), *_chart_correction(run), _chart_speed(run.optimised), *_chart_sigmas(run)]
    length = format_length(run.optimised.length_m)
    note = f"Distances count from scan to scan of the {len(run.optimised)} that are used, {length} in all."
    return Section("Along the path", [note] if left_out else [], figures=charts)


def _chart_truth(run: Run, truth: Trajectory | None) -> list[Figure]:
    """Returns charts of the errors against ground truth, over distance and by segment length; empty if none is known."""
    if truth is None:
        return []
    tracks = ((run.before, ORANGE, run.odometry), ("optimised", BLUE, run.optimised))
    errors = [(name, colour, trace_errors(track, truth)) for name, colour, track in tracks]
    curves = [Curve(name, colour, over(*traced)) for name, colour, traced in errors if traced is not None]
    charts = []
    if curves:
        caption = "distance to ground truth, with which the best rigid motion aligns each trajectory, as evo's ape does"
        chart = Chart("error [m]", tuple(curves), log=() if _are_alike(curves) else ("y",), x_title=_DISTANCE)
        charts.append(Figure(draw_chart(chart), "Error over distance", caption))
    moved, turned = [], []
    for name, colour, track in tracks:
        drift = measure_drift_by_length(track, truth)
        if drift is not None:
            shift = over(drift.lengths_m, drift.translation_percent)
            moved.append(Curve(f"{name}: translation", colour, shift, "-o"))
            turn = over(drift.lengths_m, drift.rotation_deg_per_100m)
            turned.append(Curve(f"{name}: rotation", colour, turn, "--o", beside=True))
            caption = (
                f"mean error of KITTI's segments of {drift.lengths_m[0]:g} m to {drift.lengths_m[-1]:g} m "
                f"({drift.counts.sum():,} of them) against ground truth"
            )
    if moved:
        log = [name for name, some in (("y", moved), ("beside", turned)) if not _are_alike(some)]
        chart = Chart(
            "translation [%]",
            (*moved, *turned),
            log=log,
            x_title="length of segment [m]",
            beside="rotation [°/100 m]",
        )
        charts.append(Figure(draw_chart(chart), "Drift by segment length", caption))
    return charts


def _are_alike(curves: Sequence[Curve]) -> bool:
    """Returns whether the largest median of the curves is at most `_ALIKE` times the smallest: one linear axis suits all."""
    medians = [float(np.median(curve.points[:, 1])) for curve in curves]
    return max(medians) <= _ALIKE * min(medians)


def _chart_both(heading: str, caption: str, title: str, left: Sequence[Curve], beside: str, right: Curve) -> Figure:
    """Returns a chart over distance, with curves on the left y axis and one curve on the right y axis.

    Args:
        heading: heading of the figure.
        caption: caption of the figure.
        title: title of the left y axis, with its unit.
        left: curves on the left y axis.
        beside: title of the right y axis, with its unit.
        right: curve on the right y axis.
    """
    return Figure(draw_chart(Chart(title, (*left, right), x_title=_DISTANCE, beside=beside)), heading, caption)


def _chart_correction(run: Run) -> list[Figure]:
    """Returns a chart of how far optimisation moves each pose.

    The list is empty if odometry does not cover all poses, or if optimisation moved none, since a chart of rounding errors
    would look like drift.
    """
    stamps, after = run.optimised.stamps_us, run.optimised.poses
    if _left_as_it_was(run) or not run.odometry.covers(int(stamps[0]), int(stamps[-1]), 0):
        return []
    poses = run.odometry.at(stamps)
    before = se2.compose(se2.compose(after[0], se2.inverse(poses[0])), poses)
    turned = np.unwrap(after[:, 2] - before[:, 2])
    turned -= 2.0 * np.pi * np.round(turned[0] / (2.0 * np.pi))
    path = se2.path_lengths(after)
    moved = Curve("moved", BLUE, over(path, np.hypot(*(after[:, :2] - before[:, :2]).T)))
    turn = Curve("turned", PURPLE, over(path, np.rad2deg(turned)), "--", beside=True)
    caption = f"how far the optimised trajectory lies from the earlier one ({run.before}); the first poses are the same"
    return [_chart_both("Correction over distance", caption, "moved by [m]", [moved], "turned by [°]", turn)]


def _chart_speed(track: Trajectory) -> Figure:
    """Returns a chart of the speed and the yaw rate of a trajectory over the path.

    Scans whose stamps are much closer than usual share one value: over a millisecond, the errors of two poses and of their
    stamps would show as speeds that nothing had.
    """
    times = track.seconds(int(track.stamps_us[0]))
    ends = se2.select_apart(times, _SHORTEST_STEP)
    ends[-1] = len(track) - 1
    stamps_us = track.stamps_us[ends]
    twists = track.mean_twists(stamps_us[:-1], stamps_us[1:])
    path = se2.path_lengths(track.poses)[ends[1:]]
    speed = Curve("speed forward", BLUE, over(path, twists[:, 0]))
    rate = Curve("yaw rate", PURPLE, over(path, np.rad2deg(twists[:, 2])), "--", beside=True)
    caption = "of the optimised trajectory, from scan to scan"
    if len(ends) < len(track):
        least_s = _SHORTEST_STEP * float(np.median(np.diff(times)))
        caption += f", over at least {least_s:.2g} s where stamps are closer"
    return _chart_both("Speed and yaw rate", caption, "speed [m/s]", [speed], "yaw rate [°/s]", rate)


def _chart_sigmas(run: Run) -> list[Figure]:
    """Returns a chart of the standard deviations of every pose; an empty list if the covariances are not known."""
    sure = run.covariances
    if not len(sure.indices):
        return []
    sigmas = np.sqrt(np.maximum(np.diagonal(sure.covariances, axis1=1, axis2=2), 0.0))
    path = se2.path_lengths(run.optimised.poses)[sure.indices]
    left = [Curve("along", BLUE, over(path, sigmas[:, 0])), Curve("across", ORANGE, over(path, sigmas[:, 1]))]
    heading = Curve("heading", PURPLE, over(path, np.rad2deg(sigmas[:, 2])), "--", beside=True)
    caption = "one standard deviation in the pose's own frame, with the first pose held fixed"
    return [_chart_both("Covariance along the path", caption, "position, 1σ [m]", left, "heading, 1σ [°]", heading)]


def _list_numbers(run: Run, recording: Recording, summary: Mapping[str, Any]) -> Section:
    """Returns the section of numbers at the end of a run's page; angles are in degrees."""
    parts = {**summary, **part_of(summary, "sensors")}
    groups = [(f"Map quality: {run.before} → optimised", _list_quality(run, recording, part_of(summary, "psi")))]
    for group, heading in _GROUPS.items():
        values = list_values(group, part_of(parts, group))
        if group in ("mount", "gyroscope", "gnss", "chirps"):  # unknown values are left out
            values = [(label, text) for label, text in values if text != ABSENT]
        if group == "runtime_s" and summary.get("peak_rss_mb") is not None:
            values.append(("peak memory", label_value("peak_rss_mb", summary["peak_rss_mb"])[1]))
        if values:
            groups.append((heading, values))
    return Section("Numbers", numbers=groups)


def _list_quality(run: Run, recording: Recording, psi: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Returns names and texts of numbers that tell how good the map is, each before and after optimisation.

    `psi` is the part `psi` of summary.json.
    """
    across, matched = ((psi.get(f"{key}_odometry"), psi.get(f"{key}_optimised")) for key in ("across_passes", "matched"))
    tracks = map(recording.complete, (run.odometry, run.optimised))
    rows = [
        ("points matched", _show_change(map(format_matched, matched), format_change(*matched) if all(matched) else "")),
        ("points", _show_change([f"{len(pointmap):,}" for pointmap in (run.map_odometry, run.map_optimised)])),
        ("path", _show_change(format_value(track.length_m, " m") for track in tracks)),
    ]
    if None not in across:
        rows.insert(0, ("ψ per point across passes", _show_change(map(format_value, across), format_change(*across))))
    return rows


def _show_change(both: Iterable[str], change: str = "") -> str:
    return " → ".join(both) + (f" ({change})" if change else "")
