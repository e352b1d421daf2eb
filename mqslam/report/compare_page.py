"""The page of a comparison."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from mqslam.auditing.sizes import TORN_INFLATION
from mqslam.errors import tolerate
from mqslam.execution.files import write_bytes
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
from mqslam.report.explorers.compare_explorer import explore_comparison
from mqslam.report.explorers.scene_data import ExplorerScene, make_scene
from mqslam.report.figures.compare_figures import draw_inflation, draw_overlay, draw_place, draw_revisits
from mqslam.report.formatting import ABSENT, format_length
from mqslam.report.inputs.compare_report import CompareReport
from mqslam.report.page import collect, name_values, section_of, version_in, write_page
from mqslam.report.places.standstills import select_moving_places, select_moving_windows

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
    threshold = report.summary.get("threshold") or TORN_INFLATION
    parts = CompareParts(
        trajectories=collect("the pictures of the trajectories", lambda: _show_trajectories(report, threshold), failures),
        ranks=collect("the ranking", lambda: _rank_rows(report), failures),
        rows=collect("the table", lambda: _tabulate_rows(report), failures),
        explorer=collect("the map to move in", lambda: _make_scene(report, threshold), failures),
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


def _make_scene(report: CompareReport, threshold: float) -> ExplorerScene | None:
    places = (*report.places, *report.stations)
    moving = select_moving_windows(report.rows, report.start_us)
    shown = select_moving_places(report.rows, places, report.start_us)
    explorer = explore_comparison(report.rows, places, shown, moving, report.ground_truth, report.start_us, threshold)
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


def _show_trajectories(report: CompareReport, threshold: float) -> Section | None:
    if not report.rows:
        return None
    caption = "all starting from one pose, as far as they have one start in common"
    if report.ground_truth is not None:
        caption = "each laid on the ground truth by the best rigid motion"
    trajectories = Figure(draw_overlay(report.rows, report.ground_truth, opaque=False), "Trajectories", caption)
    caption = "running median over the windows in which the radar moved: how far a window's map is from its own best"
    moving = select_moving_windows(report.rows, report.start_us)
    charts = [Figure(draw_inflation(report.rows, moving, threshold), "Inflation of the windows", caption)]
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
