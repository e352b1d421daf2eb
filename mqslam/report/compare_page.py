"""The page of a comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mqslam.audit.judge import torn_threshold
from mqslam.compare.comparison import Comparison
from mqslam.compare.judgement import Judged, Place
from mqslam.compare.rows import Row as ComparedRow
from mqslam.config import AuditConfig, dump_yaml
from mqslam.core.trajectory import Trajectory
from mqslam.errors import tolerate
from mqslam.evaluation import Evaluation
from mqslam.execution.files import write_bytes
from mqslam.report.content import (
    Figure,
    Frame,
    Gallery,
    Numbers,
    Part,
    Row,
    Section,
    Table,
    Thumbnail,
    ThumbnailCard,
    Values,
)
from mqslam.report.explorers.compare_explorer import explore_comparison
from mqslam.report.explorers.scene import Scene, make_scene
from mqslam.report.figures.compare_figures import draw_inflation, draw_overlay, draw_place, draw_revisits
from mqslam.report.page import collect, name_values, section_of, version_in, write_page
from mqslam.report.wording import ABSENT, format_length


@dataclass(frozen=True, slots=True)
class CompareReport:
    """A comparison as its page shows it.

    Args:
        title: heading of the page.
        summary: content of compare.json.
        rows: the rows that ran.
        failed: the rows that did not.
        places: where the rows differ most; the rows' crops begin with these.
        stations: places all along the path, whose crops follow.
        start_us: stamp of the recording's start, from which places count their time [us].
        agreement: how far every two rows are apart.
        ground_truth: for comparison only, in any fixed frame, or None.
        table: head and rows as the terminal shows them.
        warnings: what the reader has to know before the numbers.
        settings_yaml: every setting used, as in config.yaml.
        notes: what the reader should know about how the recording was understood.
    """

    title: str
    summary: Mapping[str, Any]
    rows: tuple[Judged, ...]
    failed: tuple[ComparedRow, ...]
    places: tuple[Place, ...]
    stations: tuple[Place, ...]
    start_us: int
    agreement: tuple[tuple[str, str, Evaluation], ...]
    ground_truth: Trajectory | None
    table: tuple[tuple[str, ...], ...]
    warnings: tuple[str, ...]
    settings_yaml: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class CompareParts:
    """The parts of the page, as compare.html shows them."""

    rows: Part[Section]
    trajectories: Part[Section]
    explorer: Part[Scene]
    places: Part[Gallery]
    numbers: Part[Numbers]


def report_comparison(comparison: Comparison, summary: Mapping[str, Any], table: Sequence[Sequence[str]]) -> CompareReport:
    """Returns a comparison as its page shows it.

    Args:
        comparison: the finished comparison.
        summary: content of compare.json.
        table: head and rows as the terminal shows them.
    """
    recording = comparison.recording
    return CompareReport(
        title=recording.path.resolve().name,
        summary=summary,
        rows=tuple(comparison.judged.values()),
        failed=tuple(row for row in comparison.rows if row.failure is not None),
        places=comparison.places,
        stations=comparison.stations,
        start_us=recording.start_us,
        agreement=comparison.agreement,
        ground_truth=recording.ground_truth,
        table=tuple(tuple(line) for line in table),
        warnings=tuple(summary["warnings"]),
        settings_yaml=dump_yaml(comparison.settings),
        notes=recording.notes,
    )


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
    threshold = report.summary.get("threshold") or torn_threshold(AuditConfig())
    parts = CompareParts(
        trajectories=collect("the pictures of the trajectories", lambda: _show_trajectories(report, threshold), failures),
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
    )
    write_page(path, "compare.html", frame, parts)
    return failures


def _make_scene(report: CompareReport, threshold: float) -> Scene | None:
    places = (*report.places, *report.stations)
    return make_scene(explore_comparison(report.rows, places, report.ground_truth, report.start_us, threshold))


def _tabulate_rows(report: CompareReport) -> Section | None:
    if not report.table:
        return None
    head, *rows = report.table
    judges = "against ground truth and without it" if report.ground_truth is not None else "without ground truth"
    note = f"The same returns and the same judges for every row, {judges}."
    return Section("Rows", (note,), table=Table(head, tuple(Row(name, tuple(values)) for name, *values in rows)))


def _show_trajectories(report: CompareReport, threshold: float) -> Section | None:
    if not report.rows:
        return None
    caption = "all starting from one pose, as far as they have one start in common"
    if report.ground_truth is not None:
        caption = "each laid on the ground truth by the best rigid motion"
    trajectories = Figure(draw_overlay(report.rows, report.ground_truth, opaque=False), "Trajectories", caption)
    caption = "a dot per window and their running median: how far a window's map is from its own best"
    charts = [Figure(draw_inflation(report.rows, threshold), "Inflation of the windows", caption)]
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
    note = "The first of each pair judged as if the second were the truth; that two agree makes neither right."
    return Numbers("Agreement", _tabulate_agreement(report), note, cards)


def _tabulate_agreement(report: CompareReport) -> Table | None:
    rows = tuple(
        Row(
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
