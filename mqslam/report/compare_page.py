"""Makes the page of a comparison. Each row is a front end or trajectory, with one colour and line style in all pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from mqslam.auditing.table import TESTS, apply_tolerance
from mqslam.auditing.verdict import VerdictStatus
from mqslam.auditing.windows.windows import WindowAudit
from mqslam.comparison.best import CRITERIA, Standing, find_best
from mqslam.comparison.comparison import Comparison
from mqslam.comparison.judgement import JudgedRow, Place
from mqslam.config import dump_yaml
from mqslam.core import se2
from mqslam.core.statistics import pick_evenly
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import join_words, list_reasons
from mqslam.errors import tolerate
from mqslam.evaluation import Evaluation, align_positions
from mqslam.execution.files import write_bytes
from mqslam.mapping.render import TRAVEL_M, TRAVEL_RAD
from mqslam.report import explorer
from mqslam.report.canvas import (
    OUTERMOST,
    SHEET_SHAPE,
    SQUARE,
    TRUTH_GREY,
    Chart,
    Curve,
    Drawing,
    Points,
    View,
    draw_chart,
    draw_world,
    find_common_view,
    over,
)
from mqslam.report.explorer import LEAST_M, LEVELS, Layer, explore, trace_inflation, values_of
from mqslam.report.page import Cell, Explorer, Figure, Page, Section, Table
from mqslam.report.words import ABSENT, format_length, list_facts, list_values, part_of
from mqslam.results.compare_results import explain_table

# the looks of the page; no result depends on them
_COLOURS: Final = ("#0b5fb0", "#d55e00", "#00886a", "#a8327e", "#7a5c00", "#3aa5dd")
_STYLES: Final[tuple[Any, ...]] = ("-", "--", "-.", ":", (0, (6, 1.5, 1, 1.5, 1, 1.5)))
_MEDIAN_OF = 15  # number of windows in the running median
_HALF_SIDE_M = 30.0  # half the side of the interactive map's close view of a place
_CLOSE_M, _FAR_M = 60.0, 300.0  # shortest and longest side of the picture of the place where the rows differ most
# The shortest side of that picture is not longer than this share of the side of the maps: the maps of rooms are small.
_CLOSE_SHARE = 0.25
_SIDE = 20.0  # side of that picture divided by the distance between the rows
_ENOUGH = 100_000  # largest number of points of a map from which its extent is computed


def write_compare_page(
    folder: Path, comparison: Comparison, summary: Mapping[str, Any], table: Sequence[Sequence[str]], marked: frozenset[Any]
) -> list[str]:
    """Writes a comparison's page and its picture of all trajectories into an existing folder.

    Args:
        folder: the folder.
        comparison: the finished comparison.
        summary: content of compare.json.
        table: lines of the table as the terminal shows them, the head first.
        marked: line and column in the table of each value that is the best of its column; the head is line 0.

    Returns:
        A message for each part that could not be made, with the reason; the page shows them, too.

    Raises:
        OutputError: a file cannot be written.
    """
    recording = comparison.recording
    rows = list(comparison.judged.values())
    page = Page(
        recording.path.resolve().name,
        summary,
        dump_yaml(comparison.settings),
        facts=list_facts(summary),
        notes=recording.notes,
        conclusion=str(part_of(summary, "best").get("sentence", "")),
    )
    with tolerate("overlay.png", page.failures):
        write_bytes(folder / "overlay.png", draw_overlay(rows, recording.ground_truth))
    notes = explain_table(summary, marked, "Bold and green")
    page.add("the table", lambda: _tabulate_rows(comparison, table, marked, notes))
    page.add("where the rows differ", lambda: _show_difference(comparison))
    page.add_explorer(
        lambda: explore_comparison(comparison),
        [("the pictures of the trajectories", lambda: _show_trajectories(comparison))],
    )
    page.add("the numbers", lambda: _list_numbers(comparison, summary))
    return page.write(folder)


def rank_rows(rows: Sequence[JudgedRow]) -> dict[str, int]:
    """Ranks rows by repeated use of `find_best`: the rank of a row is 1 plus the number of rows that are better.

    Args:
        rows: rows that ran.

    Returns:
        The rank of each row by its name, the best first. Rows between which no criterion decides share a rank: after two
        rows of rank 1 comes rank 3.
    """
    left = [Standing.of(row) for row in rows]
    ranks: dict[str, int] = {}
    while left:
        best = find_best(left)
        ranks |= dict.fromkeys(best.rows if best is not None else (left[0].name,), len(ranks) + 1)
        left = [standing for standing in left if standing.name not in ranks]
    return ranks


def _tabulate_rows(
    comparison: Comparison, table: Sequence[Sequence[str]], marked: frozenset[Any], notes: Sequence[str]
) -> Section:
    """Returns the table of the rows with their ranks: the best row first, rows that failed last, with the reason.

    All cells but the ranks are the same as in the terminal's table.

    Args:
        comparison: the finished comparison.
        table: lines of the terminal's table, the head first.
        marked: line and column in `table` of each value that is the best of its column.
        notes: what a reader of the table must know.
    """
    (_, *head), *lines = table
    ranks = rank_rows(list(comparison.judged.values()))
    rows: list[tuple[str | Cell, ...]] = []
    for number, (name, *values) in sorted(enumerate(lines, 1), key=lambda line: ranks.get(line[1][0], len(lines) + 1)):
        if name not in ranks:
            rows.append((name, values[0]))
            continue
        cells = [Cell(value, best=True) if (number, k) in marked else value for k, value in enumerate(values, 1)]
        if "verdict" in head:
            at = head.index("verdict")
            cells[at] = VerdictStatus(values[at])
        rows.append((name, str(ranks[name]), *cells))
    judges = "without ground truth" if comparison.recording.ground_truth is None else "against ground truth and without it"
    ranking = (
        f"Rank 1 is the best row: {join_words(list(CRITERIA))} decide the ranks, in this order, as far as they are known. "
        "Rows that cannot be told apart share a rank."
    )
    return Section(
        "Rows",
        [" ".join([f"Every row is judged alike, {judges}.", *notes]), ranking],
        table=Table(("", "rank", *head), rows),
    )


def _style_of(k: int) -> tuple[str, Any]:
    """Returns the colour of row k in pictures, and the style of its line."""
    return _COLOURS[k % len(_COLOURS)], _STYLES[k % len(_STYLES)]


def _show_trajectories(comparison: Comparison) -> Section | None:
    rows, truth = list(comparison.judged.values()), comparison.recording.ground_truth
    if not rows:
        return None
    caption = "all moved to one pose at the first time that all of them cover"
    if truth is not None:
        caption = "each aligned with the ground truth by the best rigid motion"
    trajectories = Figure(draw_overlay(rows, truth, opaque=False), "Trajectories", caption)
    moved = f"the decided windows in which the {comparison.recording.sensor_name} moved"
    caption = f"running median over {moved}: how far a window's map is from its own best"
    charts = [Figure(draw_chart(_chart_inflation(comparison)), "Inflation of the windows", caption)]
    curves = []
    for k, row in enumerate(rows):
        offsets = np.sort([r.distance_m for r in row.audit.revisits if r.sure])
        if len(offsets):
            colour, style = _style_of(k)
            reached = over(np.maximum(offsets, LEAST_M), 100.0 * np.arange(1, len(offsets) + 1) / len(offsets))
            stairs = np.repeat(reached, 2, axis=0)
            steps = np.column_stack([stairs[1:, 0], stairs[:-1, 1]])
            curves.append(Curve(f"{row.row.name} ({len(offsets)})", colour, steps, style, 1.6))
    if curves:
        caption = "share of the revisits whose two passes have a smaller offset, with the number of revisits in brackets"
        chart = Chart("revisits [%]", tuple(curves), x_title="offset less than [m]", top=102.0, log=("x",))
        charts.append(Figure(draw_chart(chart), "Offset of the revisits", caption))
    return Section("Trajectories", figures=[trajectories], stacked=charts)


def draw_overlay(rows: Sequence[JudgedRow], truth: Trajectory | None, *, opaque: bool = True) -> bytes:
    """Draws the trajectories of all rows over each other, as the content of a PNG file.

    Args:
        rows: rows that ran.
        truth: ground truth, with which the best rigid motion aligns each trajectory; if it is None or cannot be aligned
            with every trajectory, all start from one pose.
        opaque: whether the background is white, for a picture outside a page, rather than transparent.
    """
    motions, shown = _find_common_frame([row.trajectory for row in rows], truth)
    curves = [] if shown is None else [Curve("ground truth", TRUTH_GREY, shown, width=5.0, alpha=0.6)]
    for k, (row, motion) in enumerate(zip(rows, motions, strict=True)):
        colour, style = _style_of(k)
        curves.append(Curve(row.row.name, colour, se2.compose(motion, row.trajectory.poses)[:, :2], style, 1.6))
    return draw_world([Drawing((), curves)], SHEET_SHAPE, opaque=opaque)[0]


def _find_common_frame(tracks: Sequence[Trajectory], truth: Trajectory | None) -> tuple[list[se2.Array], Points | None]:
    """Finds one frame for all trajectories: the frame of the ground truth, or the pose at their common start.

    Returns:
        For each trajectory the motion (3,) x, y [m], yaw [rad] that brings it into the frame, and positions (N, 2) x, y [m]
        of the ground truth in the time of the trajectories. The positions are None if there is no ground truth with which
        all trajectories can be aligned.
    """
    if truth is not None:
        motions = [motion for track in tracks if (motion := align_positions(track, truth)) is not None]
        if tracks and len(motions) == len(tracks):
            first, last = min(t.stamps_us[0] for t in tracks), max(t.stamps_us[-1] for t in tracks)
            covered = (truth.stamps_us >= first) & (truth.stamps_us <= last)
            return motions, truth.poses[covered, :2]
    begin = np.array([max((t.stamps_us[0] for t in tracks), default=0)])
    return [se2.inverse(t.at(begin)[0]) for t in tracks], None


def _chart_inflation(comparison: Comparison) -> Chart:
    """Returns a chart of the running median of each row's inflation, over the decided windows in which the sensor moves."""
    rows, curves = list(comparison.judged.values()), []
    for k, (row, windows) in enumerate(zip(rows, select_moving_windows(rows, comparison.recording.start_us), strict=True)):
        if windows:
            curves.append(Curve(row.row.name, _style_of(k)[0], smooth_inflation(windows), _style_of(k)[1], 1.6))
    return Chart("inflation, running median", tuple(curves), LEVELS, log=("y",))


def smooth_inflation(windows: Sequence[WindowAudit]) -> Points:
    """Returns (W, 2): the time [s] at the middle of each window, and the running median of the windows' inflation there."""
    times, inflation = trace_inflation(windows).T
    return over(times, median_filter(inflation, min(_MEDIAN_OF, len(inflation)), mode="nearest"))


def select_moving_windows(rows: Sequence[JudgedRow], start_us: int) -> list[list[WindowAudit]]:
    """Returns for each row the decided windows in which the row's own trajectory moves or rotates.

    Args:
        rows: rows that ran.
        start_us: stamp of the recording's start [us].
    """
    selected = []
    for row in rows:
        windows = [window for window in row.audit.windows if window.undecided is None]  # else inflation means nothing
        if windows:
            moves = _are_moving(row.trajectory, [(window.t0, window.t1) for window in windows], start_us)
            windows = [window for window, moved in zip(windows, moves, strict=True) if moved]
        selected.append(windows)
    return selected


def select_moving_places(rows: Sequence[JudgedRow], places: Sequence[Place], start_us: int) -> list[int]:
    """Returns the indices of the places in which the trajectory of any row moves or rotates.

    Args:
        rows: rows that ran.
        places: the places.
        start_us: stamp of the recording's start [us].
    """
    if not places:
        return []
    spans = [(place.t0, place.t1) for place in places]
    moves = np.any([_are_moving(row.trajectory, spans, start_us) for row in rows], axis=0)
    return [int(k) for k in np.flatnonzero(moves)]


def _are_moving(track: Trajectory, spans: Sequence[tuple[float, float]], start_us: int) -> NDArray[np.bool_]:
    """Returns a mask (N,) of the spans of time in which a trajectory moves or rotates.

    Its poses at begin and end of the span must be at least `TRAVEL_M` or `TRAVEL_RAD` apart, as for a scan that is rendered.
    Before its first pose and after its last pose, the trajectory is taken to stand still.

    Args:
        track: the trajectory.
        spans: begin and end of N spans of time [s since the recording's start].
        start_us: stamp of the recording's start [us].
    """
    stamps = start_us + np.round(1e6 * np.array(spans)).astype(np.int64)
    begins, ends = np.clip(stamps, track.stamps_us[0], track.stamps_us[-1]).T
    before, after = track.at(begins), track.at(ends)
    moved = np.hypot(*(after - before)[:, :2].T) >= TRAVEL_M
    turned = np.abs(se2.wrap(after[:, 2] - before[:, 2])) >= TRAVEL_RAD
    return np.asarray(moved | turned)


def explore_comparison(comparison: Comparison) -> Explorer | None:
    """Returns the interactive map of a comparison: maps, trajectories, inflation over time and close views of every row.

    Returns None if no row has a map.
    """
    rows, start_us = list(comparison.judged.values()), comparison.recording.start_us
    tracks = [row.trajectory for row in rows]
    motions, true = _find_common_frame(tracks, comparison.recording.ground_truth)
    colours = [_style_of(k)[0] for k in range(len(rows))]
    layers: list[Layer] = []
    for row, track, motion, colour in zip(rows, tracks, motions, colours, strict=True):
        path, points = se2.compose(motion, track.poses)[:, :2], se2.transform(motion, row.map.points)
        times, values = track.seconds(start_us), values_of(row.map)
        layers.append(Layer(row.row.name, colour, times, path, points, values, shown=not layers, ink=colour))
    places = (*comparison.places, *comparison.stations)
    order = sorted(select_moving_places(rows, places, start_us), key=lambda k: places[k].t0)
    chart = _chart_inflation(comparison)
    return explore(
        layers,
        [chart] if chart.curves else [],
        [_show_place(places[k], [(r.row.name, r.crops[k], c) for r, c in zip(rows, colours, strict=True)]) for k in order],
        (
            "Click a dot to see one window under every row: the crisper map has the better motion.",
            "A window is seen from the sensor, ahead to the right. "
            f"Places where the {comparison.recording.sensor_name} stood still are left out.",
        ),
        lines=[] if true is None else [Curve("ground truth", TRUTH_GREY, true, width=4.0)],
        first=order.index(min(order)) if order else 0,
    )


def _show_place(place: Place, crops: Sequence[tuple[str, Points, str]]) -> explorer.Place:
    """Returns a place with its close views; `crops` holds the name, the points (M, 2) [m] and the colour of each row."""
    text = "the points of one window under every row"
    if place.apart_m:
        text = f"here the motions of two rows differ by up to {format_length(place.apart_m)}, yaw included"
    views = [
        (name, [points[np.abs(points).max(axis=1, initial=0.0) <= _HALF_SIDE_M]], (colour,))
        for name, points, colour in crops
    ]
    return explorer.Place(place.t0, place.t1, f"{place.t0:.1f} s to {place.t1:.1f} s", text, views)


def _show_difference(comparison: Comparison) -> Section:
    """Returns a section with a picture of the place where the rows are the farthest apart, and a table of answers.

    The answers explain how the rows are judged. With fewer than two rows there is no picture.
    """
    rows, truth = list(comparison.judged.values()), comparison.recording.ground_truth
    drawn = draw_difference(rows, truth)
    answers = Table(("question", "answer"), _answer_sceptic(comparison), holds_words=True)
    if drawn is None:
        return Section("Who judges, and by what", table=answers)
    picture, apart_m, time_s = drawn
    start = "starting from one pose" if truth is None else "each aligned with the ground truth by the best rigid motion"
    caption = f"maps and paths over each other, {start}: {format_length(apart_m)} apart {time_s:.1f} s after the start"
    return Section("Where they differ most", figures=[Figure(picture, "All rows in one map", caption)], table=answers)


def draw_difference(rows: Sequence[JudgedRow], truth: Trajectory | None) -> tuple[bytes, float, float] | None:
    """Draws the maps and trajectories of all rows over each other where the trajectories are the farthest apart.

    Args:
        rows: rows that ran.
        truth: ground truth, with which the best rigid motion aligns each trajectory; if it is None or cannot be aligned
            with every trajectory, all start from one pose.

    Returns:
        The content of a PNG file, the largest distance between two trajectories [m], and the time at which it occurs [s
        since the first time that all trajectories cover]. None for fewer than two rows.
    """
    tracks = [row.trajectory for row in rows]
    if len(tracks) < 2:
        return None
    motions, true = _find_common_frame(tracks, truth)
    first, last = max(int(t.stamps_us[0]) for t in tracks), min(int(t.stamps_us[-1]) for t in tracks)
    stamps = tracks[0].stamps_us[(tracks[0].stamps_us >= first) & (tracks[0].stamps_us <= last)]
    paths = [se2.compose(motion, track.at(stamps))[:, :2] for motion, track in zip(motions, tracks, strict=True)]
    apart_m = np.max([np.hypot(*(a - b).T) for a in paths for b in paths], axis=0)
    k = int(np.argmax(apart_m))
    maps_of = [row.map.points for row in rows]
    some = [se2.transform(motion, own[pick_evenly(len(own), _ENOUGH)]) for motion, own in zip(motions, maps_of, strict=True)]
    view = find_close_view(np.mean([path[k] for path in paths], axis=0), float(apart_m[k]), [*some, *paths])
    maps, lines = [], [] if true is None else [Curve("ground truth", TRUTH_GREY, true, width=5.0, alpha=0.6)]
    for n, (row, motion, path) in enumerate(zip(rows, motions, paths, strict=True)):
        colour, style = _style_of(n)
        points = se2.transform(motion, row.map.points)
        maps.append(Curve("", colour, points[view.contains(points)], ".", 2.5))
        lines.append(Curve(row.row.name, colour, path, style, 2.5))
    return draw_world([Drawing((), [*maps, *lines])], view=view)[0], float(apart_m[k]), 1e-6 * float(stamps[k] - stamps[0])


def find_close_view(at: Points, apart_m: float, seen: Sequence[Points]) -> View:
    """Returns a square in which the distance between the rows at a place can be seen, no larger than the rows' maps.

    Args:
        at: (2,) middle x, y of the square [m].
        apart_m: distance between the rows at the place [m].
        seen: points and paths of the rows, each (N, 2) x, y [m].
    """
    whole = find_common_view(seen, SQUARE, OUTERMOST)
    side_m = whole.x1 - whole.x0
    shortest, longest = min(_CLOSE_M, _CLOSE_SHARE * side_m), min(_FAR_M, side_m)
    half = 0.5 * float(np.clip(_SIDE * apart_m, shortest, longest))
    return View(at[0] - half, at[0] + half, at[1] - half, at[1] + half)


def _answer_sceptic(comparison: Comparison) -> list[tuple[str, str]]:
    """Returns questions that a sceptical reader may have about the judgement of the rows, each with its answer."""
    audits = {name: row.audit for name, row in comparison.judged.items()}
    who = (
        f"The same audit for every row: the same returns of the same {comparison.compared:,} scans, the same settings, and "
        "nothing that says which front end a trajectory comes from. It uses no ground truth. It registers scans by psi, "
        "which the front end psi minimises, too, so the audit is not independent of that row. Errors against ground truth "
        "are independent of all rows."
    )
    tolerated = apply_tolerance(comparison.settings.audit, comparison.settings.verdict)
    differ = (
        "The two ask for different things. Ground truth says how far poses are off over the whole drive, and seldom knows a "
        "few centimetres. The audit says whether neighbouring scans lie on each other, and counts bends of "
        f"{100.0 * tolerated.bend_m:g} cm and more. A row that is the best by ground truth and fails is "
        "the nearest to the true path, and its map is still doubled or blurred in many places. A row that passes may drift "
        "slowly where no place is passed twice."
    )
    tests = [f"{test.name}: {test.compares}" for test in TESTS if any(test.name in audit.tests for audit in audits.values())]
    return [
        ("Who judges?", who),
        ("By what?", "; ".join(tests)),
        ("What if the best by ground truth fails?", differ),
        *(
            (
                f"Why is the verdict on {name} {audit.verdict.status}?",
                "; ".join([audit.verdict.diagnosis, *list_reasons(audit.verdict._asdict())]),
            )
            for name, audit in audits.items()
        ),
    ]


def _list_numbers(comparison: Comparison, summary: Mapping[str, Any]) -> Section:
    groups = [("Recording", list_values("dataset", part_of(summary, "dataset")))]
    if comparison.agreement:
        pairs = [(f"{a} – {b}", ", ".join(_format_errors(errors))) for a, b, errors in comparison.agreement]
        groups.append(("Agreement of two rows: RMSE, drift, rotation, speed", pairs))
    failed = [(row.name, row.failure) for row in comparison.rows if row.failure is not None]
    if failed:
        groups.append(("Failed", failed))
    note = "In a pair the first row is judged as if the second were the truth. Two rows that agree may both be wrong."
    return Section("Numbers", [note] if comparison.agreement else [], numbers=groups)


def _format_errors(errors: Evaluation) -> list[str]:
    """Returns position error, drift, rotation drift and speed error as text, a dash for each that is None."""
    shown = (
        (errors.ate_rmse_m, " m"),
        (errors.drift_percent, " %"),
        (errors.drift_deg_per_100m, " °/100 m"),
        (errors.rpe_v_rms, " m/s"),
    )
    return [ABSENT if value is None else f"{value:.3f}{unit}" for value, unit in shown]
