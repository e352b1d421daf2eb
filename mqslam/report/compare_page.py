"""The report of a comparison."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mqslam.compare.judgement import Judged, Place
from mqslam.compare.rows import Row
from mqslam.core.trajectory import Trajectory
from mqslam.errors import tolerate
from mqslam.evaluation import Evaluation
from mqslam.execution.files import write_bytes, write_text
from mqslam.report.audit_figures import threshold
from mqslam.report.compare_figures import inflation_chart, overlay, place_pictures, revisit_chart
from mqslam.report.explorers.compare_explorer import compare_explorer
from mqslam.report.explorers.explorer import Explorer, explorer
from mqslam.report.page import (
    ABSENT,
    captioned,
    draw,
    grid,
    named_card,
    note,
    page,
    pairs_card,
    picture,
    section,
    titled_card,
    warning_box,
)
from mqslam.report.spots import length

__all__ = ["CompareReport", "overlay", "write_compare_pages", "write_compare_report"]


@dataclass(frozen=True, slots=True)
class CompareReport:
    """A comparison as its report shows it.

    Args:
        title: heading of the page.
        summary: content of compare.json.
        rows: those that ran.
        failed: those that did not.
        places: where the rows differ most; the rows' crops begin with these.
        stations: places all along the way, whose crops follow.
        start_us: stamp of the recording's start, from which places count their time [us].
        agreement: how far every two rows are apart.
        ground_truth: for comparison only, in any fixed frame, or None.
        table: head and rows as the terminal shows them.
        warnings: what the reader has to know before the numbers.
        settings_yaml: every setting used, as in config.yaml.
    """

    title: str
    summary: Mapping[str, Any]
    rows: tuple[Judged, ...]
    failed: tuple[Row, ...]
    places: tuple[Place, ...]
    stations: tuple[Place, ...]
    start_us: int
    agreement: tuple[tuple[str, str, Evaluation], ...]
    ground_truth: Trajectory | None
    table: tuple[tuple[str, ...], ...]
    warnings: tuple[str, ...]
    settings_yaml: str


def write_compare_pages(folder: Path, report: CompareReport) -> list[str]:
    """Write a comparison's picture of all trajectories and its report into an existing folder.

    Returns:
        what could not be made, and why.

    Raises:
        OutputError: a file cannot be written.
    """
    failures: list[str] = []
    with tolerate("overlay.png", failures):
        write_bytes(folder / "overlay.png", overlay(report.rows, report.ground_truth))
    with tolerate("report.html", failures):
        shown = replace(report, warnings=(*report.warnings, *failures))
        failures += write_compare_report(folder / "report.html", shown)
    return failures


def write_compare_report(path: Path, report: CompareReport) -> list[str]:
    """Write a comparison's report as one HTML file that opens without a network.

    Returns:
        what of it could not be drawn, and why; the report says it too.

    Raises:
        OutputError: the file cannot be written.
    """
    failures: list[str] = []
    limit = report.summary.get("threshold") or threshold(None)
    still = draw("the pictures of the trajectories", lambda: _trajectories(report, limit), failures)
    parts = (
        draw("the table", lambda: _table(report), failures),
        draw("the map to move in", lambda: explorer(_explored(report, limit), still), failures, still),
        draw("where the rows differ", lambda: _places(report), failures),
        draw("the numbers", lambda: _numbers(report), failures),
    )
    head = (warning_box([*report.warnings, *failures]),)
    write_text(path, page(report.title, head, parts, report.settings_yaml, report.summary))
    return failures


def _explored(report: CompareReport, limit: float) -> Explorer:
    """The interactive part."""
    spots = (*report.places, *report.stations)
    return compare_explorer(report.rows, spots, report.ground_truth, report.start_us, limit)


def _table(report: CompareReport) -> str:
    if not report.table:
        return ""
    head, *rows = report.table
    judged = "against ground truth and without it" if report.ground_truth is not None else "without ground truth"
    explained = note(f"The same returns and the same judges for every row, {judged}.")
    return f'<h2>Rows</h2>{explained}<section class="card">{grid(head, rows)}</section>'


def _trajectories(report: CompareReport, limit: float) -> str:
    if not report.rows:
        return ""
    if report.ground_truth is not None:
        caption = "each laid on the ground truth by the best rigid motion"
    else:
        caption = "all starting from one pose, as far as they have one start in common"
    pictures = picture(overlay(report.rows, report.ground_truth, opaque=False), "Trajectories", caption)
    said = "a dot a window, the line their running median; how far a window's map is from its own best"
    charts = picture(inflation_chart(report.rows, limit), "Inflation of the windows", said)
    if any(r.revisit.sure for row in report.rows for r in row.audit.revisits):
        said = "share of the revisits whose two passes are off each other by less, how many there are in brackets"
        charts += picture(revisit_chart(report.rows), "Offset of the revisits", said)
    return f'<h2>Trajectories</h2><div class="pair">{pictures}<div class="stack">{charts}</div></div>'


def _places(report: CompareReport) -> str:
    """A line of small pictures per place, one per row."""
    cards = []
    for k, place in enumerate(report.places):
        title = f"{k + 1}. {place.t0:.1f} s to {place.t1:.1f} s, up to {length(place.apart_m)} apart"
        pictures = "".join(
            captioned(png, row.row.name, f"{title}, {row.row.name}")
            for row, png in zip(report.rows, place_pictures(report.rows, k, place), strict=True)
        )
        cards.append(titled_card(title, f'<div class="row">{pictures}</div>'))
    if not cards:
        return ""
    explained = note(
        "The points of one window under every row, seen from the sensor at its middle, ahead to the right; "
        "the same square for all of them, where they differ the most. The crisper map has the better motion."
    )
    return f'<h2>Where the rows differ</h2>{explained}<div class="stack">{"".join(cards)}</div>'


def _numbers(report: CompareReport) -> str:
    cards = [_agreement(report), named_card("Recording", section(report.summary, "dataset"))]
    cards.append(pairs_card("Could not run", [(row.name, row.failure or "") for row in report.failed]))
    return f'<h2>Numbers</h2><div class="tables">{"".join(cards)}</div>'


def _agreement(report: CompareReport) -> str:
    if not report.agreement:
        return ""
    head = ("of each other", "RMSE", "drift", "rotation", "speed, RMS")
    rows = [
        (
            f"{a} – {b}",
            f"{e.ate_rmse_m:.3f} m",
            _known(e.drift_percent, " %"),
            _known(e.drift_deg_per_100m, " °/100 m"),
            f"{e.rpe_v_rms:.3f} m/s",
        )
        for a, b, e in report.agreement
    ]
    explained = note("The first of each pair judged as if the second were the truth; that two agree makes neither right.")
    return titled_card("Agreement", grid(head, rows) + explained, wide=True)


def _known(value: float | None, unit: str) -> str:
    return ABSENT if value is None else f"{value:.3f}{unit}"
