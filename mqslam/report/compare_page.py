"""The page of a comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.windows.windows import WindowAudit
from mqslam.comparison.judgement import JudgedRow, Place
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.errors import tolerate
from mqslam.execution.files import write_bytes
from mqslam.mapping.render import TRAVEL_M, TRAVEL_RAD
from mqslam.report.content import (
    Figure,
    Frame,
    Gallery,
    Numbers,
    PagePart,
    RankedCard,
    Section,
    Table,
    TableRow,
    Thumbnail,
    ThumbnailCard,
    Values,
)
from mqslam.report.explorers.explorer import Chart, Explorer, ExplorerCurve, ExplorerPlace, Layer, Lines, PlaceView, Points
from mqslam.report.explorers.run_explorer import list_levels
from mqslam.report.explorers.scene_data import ExplorerScene, make_scene
from mqslam.report.figures.compare_figures import (
    TRUTH_COLOUR,
    draw_inflation,
    draw_overlay,
    draw_place,
    draw_revisits,
    find_common_frame,
    smooth_inflation,
    style_of,
)
from mqslam.report.formatting import ABSENT, format_length
from mqslam.report.inputs.compare_report import CompareReport
from mqslam.report.page import collect, name_values, section_of, version_in, write_page


def select_moving_windows(rows: Sequence[JudgedRow], start_us: int) -> list[list[WindowAudit]]:
    """Returns of each row the windows in which its own trajectory moves on.

    Args:
        rows: the rows that ran.
        start_us: stamp of the recording's start [us].
    """
    selected = []
    for row in rows:
        windows = list(row.audit.windows)
        if row.row.trajectory is not None and windows:
            spans = np.array([(window.t0, window.t1) for window in windows])
            moves = _are_moving(row.row.trajectory, spans, start_us)
            windows = [window for window, moved in zip(windows, moves, strict=True) if moved]
        selected.append(windows)
    return selected


def select_moving_places(rows: Sequence[JudgedRow], places: Sequence[Place], start_us: int) -> tuple[int, ...]:
    """Returns the numbers of the places in which the trajectory of any row moves on.

    Args:
        rows: the rows that ran.
        places: the places.
        start_us: stamp of the recording's start [us].
    """
    tracks = [row.row.trajectory for row in rows if row.row.trajectory is not None]
    if not places or not tracks:
        return tuple(range(len(places)))
    spans = np.array([(place.t0, place.t1) for place in places])
    moves = np.any([_are_moving(track, spans, start_us) for track in tracks], axis=0)
    return tuple(np.flatnonzero(moves).tolist())


def _are_moving(track: Trajectory, spans: NDArray[np.float64], start_us: int) -> NDArray[np.bool_]:
    """Returns in which spans (N, 2) of time [s] a trajectory moves or turns on (N,); it begins and ends as its ends do."""
    stamps = start_us + np.round(1e6 * spans).astype(np.int64)
    begins, ends = np.clip(stamps, track.stamps_us[0], track.stamps_us[-1]).T
    before, after = track.at(begins), track.at(ends)
    moved = np.hypot(*(after - before)[:, :2].T) >= TRAVEL_M
    turned = np.abs(se2.wrap(after[:, 2] - before[:, 2])) >= TRAVEL_RAD
    return np.asarray(moved | turned)


_HALF_SIDE_M = 30.0  # half the side of what is shown of a place


def explore_comparison(
    rows: Sequence[JudgedRow],
    places: Sequence[Place],
    shown: Sequence[int],
    windows: Sequence[Sequence[WindowAudit]],
    truth: Trajectory | None,
    start_us: int,
) -> Explorer:
    """Returns the maps and trajectories of all rows, their windows' inflation over time, and crops of every row.

    Args:
        rows: the rows that ran.
        places: places in the order of the rows' crops, the one where the rows differ most first.
        shown: numbers of the places that can be looked at.
        windows: of each row, those whose inflation is drawn.
        truth: ground truth, on which all are laid; without it they start from one pose.
        start_us: stamp of the recording's start [us].
    """
    tracks = [row.row.trajectory for row in rows if row.row.trajectory is not None]
    motions, true = find_common_frame(tracks, truth)
    colours = [style_of(k)["color"] for k in range(len(rows))]
    layers: list[Layer] = []
    for row, track, motion, colour in zip(rows, tracks, motions, colours, strict=True):
        times = track.seconds(start_us)
        values = {"time": row.map.times, "psi": row.map.psi, "intensity": row.map.intensities}
        points = se2.transform(motion, row.map.points)
        path = se2.compose(motion, track.poses)[:, :2]
        layers.append(Layer(row.row.name, colour, times, path, points, values, shown=not layers, ink=colour))
    order = sorted(shown, key=lambda k: places[k].t0)
    shown_places = []
    for k in order:
        place = places[k]
        views = tuple(PlaceView(r.row.name, (_crop_close(r.crops[k]),), (c,)) for r, c in zip(rows, colours, strict=True))
        title = f"{place.t0:.1f} s to {place.t1:.1f} s"
        text = "the points of one window under every row"
        if place.apart_m:
            text = f"here the rows differ by up to {format_length(place.apart_m)}"
        shown_places.append(ExplorerPlace(place.t0, place.t1, title, text, False, views))
    curves = tuple(
        ExplorerCurve(row.row.name, colour, *smooth_inflation(some))
        for row, colour, some in zip(rows, colours, windows, strict=True)
        if some
    )
    chart = Chart("inflation, running median", curves, list_levels(), log=True)
    return Explorer(
        layers=tuple(layers),
        charts=(chart,) if curves else (),
        places=tuple(shown_places),
        lines=(Lines("ground truth", TRUTH_COLOUR, np.asarray(true), 4.0),) if true is not None and len(true) else (),
        first=order.index(min(order)) if order else 0,
        explained=(
            "Click a dot to see one window under every row: the crisper map has the better motion.",
            "A window is seen from the sensor, ahead to the right. Places where the radar stood still are left out.",
        ),
    )


def _crop_close(points: Points) -> Points:
    """Returns the points of a crop (M, 2) [m] that are near its middle."""
    return np.asarray(points[np.abs(points).max(axis=1, initial=0.0) <= _HALF_SIDE_M])


_VERDICT: Final = "verdict"
_RANKED_BY: Final = ("drift", "ATE", "windows torn", "revisits apart", "time")  # how the columns on a card begin


@dataclass(frozen=True, slots=True)
class CompareParts:
    """The parts of the page, as compare.html shows them."""

    ranks: PagePart[tuple[RankedCard, ...]]
    rows: PagePart[Section]
    trajectories: PagePart[Section]
    explorer: PagePart[ExplorerScene]
    places: PagePart[Gallery]
    numbers: PagePart[Numbers]


def write_compare_pages(folder: Path, report: CompareReport) -> list[str]:
    """Writes a comparison's picture of all trajectories and its page into an existing folder.

    Args:
        folder: the folder.
        report: the comparison as the page shows it.

    Returns:
        what could not be made, and why.

    Raises:
        OutputError: a file cannot be written.
    """
    failures: list[str] = []
    with tolerate("overlay.png", failures):
        write_bytes(folder / "overlay.png", draw_overlay(report.rows, report.ground_truth))
    with tolerate("report.html", failures):
        shown = replace(report, warnings=(*report.warnings, *failures))
        failures += write_compare_report(folder / "report.html", shown)
    return failures


def write_compare_report(path: Path, report: CompareReport) -> list[str]:
    """Writes a comparison's page as one HTML file that opens without a network.

    Args:
        path: the file.
        report: the comparison as the page shows it.

    Returns:
        the parts that could not be drawn, and why; the page says it too.

    Raises:
        OutputError: the file cannot be written.
    """
    failures: list[str] = []
    parts = CompareParts(
        trajectories=collect("the pictures of the trajectories", lambda: _show_trajectories(report), failures),
        ranks=collect("the ranking", lambda: _rank_rows(report), failures),
        rows=collect("the table", lambda: _tabulate_rows(report), failures),
        explorer=collect("the map to move in", lambda: _make_scene(report), failures),
        places=collect("where the rows differ", lambda: _show_places(report), failures),
        numbers=collect("the numbers", lambda: _list_numbers(report), failures),
    )
    frame = Frame(
        title=report.title,
        settings_yaml=report.settings_yaml,
        version=version_in(report.summary),
        warnings=(*report.warnings, *failures),
        notes=report.notes,
        conclusion=str(section_of(report.summary, "best").get("sentence", "")),
    )
    write_page(path, "compare.html", frame, parts)
    return failures


def _make_scene(report: CompareReport) -> ExplorerScene | None:
    places = (*report.places, *report.stations)
    moving = select_moving_windows(report.rows, report.start_us)
    shown = select_moving_places(report.rows, places, report.start_us)
    explorer = explore_comparison(report.rows, places, shown, moving, report.ground_truth, report.start_us)
    return make_scene(explorer)


def _rank_rows(report: CompareReport) -> tuple[RankedCard, ...] | None:
    """Returns a card per row, the best first; None where the rows are not ranked."""
    head, *lines = report.table or ((),)
    cards = []
    for k, names in enumerate(report.ranks):
        rank = 1 + sum(map(len, report.ranks[:k]))
        for number, line in enumerate(lines, 1):
            if line[0] not in names:
                continue
            cells = dict(zip(head, line, strict=False))
            verdict = next((value for name, value in cells.items() if name.startswith(_VERDICT)), None)
            shown = [
                (name, line[column], (number, column) in report.marked)
                for column, name in enumerate(head)
                if name.startswith(_RANKED_BY) and column < len(line) and line[column] not in ("", ABSENT, "-")
            ]
            cards.append(RankedCard(rank, line[0], verdict, tuple(shown)))
    return tuple(cards) or None


def _tabulate_rows(report: CompareReport) -> Section | None:
    if not report.table:
        return None
    head, *lines = report.table
    rows = []
    for k, (name, *values) in enumerate(lines, 1):
        rows.append(TableRow(name, tuple(values), best=frozenset(column - 1 for line, column in report.marked if line == k)))
    judges = "against ground truth and without it" if report.ground_truth is not None else "without ground truth"
    note = f"The same returns and the same judges for every row, {judges}. "
    note += "The best value of a column is bold and green; ↓ less is better, ↑ more, → 1 nearer to 1."
    table = Table(head, tuple(rows))
    return Section("Rows", (note,), table=table, turned=table.turn())


def _show_trajectories(report: CompareReport) -> Section | None:
    if not report.rows:
        return None
    caption = "all starting from one pose, as far as they have one start in common"
    if report.ground_truth is not None:
        caption = "each laid on the ground truth by the best rigid motion"
    trajectories = Figure(draw_overlay(report.rows, report.ground_truth, opaque=False), "Trajectories", caption)
    caption = "running median over the windows in which the radar moved: how far a window's map is from its own best"
    moving = select_moving_windows(report.rows, report.start_us)
    charts = [Figure(draw_inflation(report.rows, moving), "Inflation of the windows", caption)]
    if any(r.revisit.sure for row in report.rows for r in row.audit.revisits):
        caption = "share of the revisits whose two passes are off each other by less, with their number in brackets"
        charts.append(Figure(draw_revisits(report.rows), "Offset of the revisits", caption))
    return Section("Trajectories", (), (trajectories,), tuple(charts))


def _show_places(report: CompareReport) -> Gallery | None:
    """Returns a line of small pictures per place, one per row."""
    cards = []
    for k, place in enumerate(report.places):
        title = f"{k + 1}. {place.t0:.1f} s to {place.t1:.1f} s, up to {format_length(place.apart_m)} apart"
        thumbnails = tuple(
            Thumbnail(png, row.row.name, f"{title}, {row.row.name}")
            for row, png in zip(report.rows, draw_place(report.rows, k, place), strict=True)
        )
        cards.append(ThumbnailCard(title, thumbnails))
    note = (
        "The points of one window under every row, seen from the sensor at its middle, ahead to the right; "
        "the same square for all of them, where they differ the most. The crisper map has the better motion."
    )
    return Gallery("Where the rows differ", note, tuple(cards)) if cards else None


def _list_numbers(report: CompareReport) -> Numbers:
    cards = (
        name_values("Recording", section_of(report.summary, "dataset")),
        Values("Could not run", tuple((row.name, row.failure or "") for row in report.failed)),
    )
    note = "The first of each pair is judged as if the second were the truth. That two rows agree makes neither right."
    return Numbers("Agreement", _tabulate_agreement(report), note, cards)


def _tabulate_agreement(report: CompareReport) -> Table | None:
    rows = tuple(
        TableRow(
            f"{a} – {b}",
            (
                f"{e.ate_rmse_m:.3f} m",
                _format_known(e.drift_percent, " %"),
                _format_known(e.drift_deg_per_100m, " °/100 m"),
                f"{e.rpe_v_rms:.3f} m/s",
            ),
        )
        for a, b, e in report.agreement
    )
    return Table(("of each other", "RMSE", "drift", "rotation", "speed, RMS"), rows) if rows else None


def _format_known(value: float | None, unit: str) -> str:
    return ABSENT if value is None else f"{value:.3f}{unit}"
