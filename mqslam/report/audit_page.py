"""The page of an audit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import numpy as np

from mqslam.auditing.judge import Audit
from mqslam.auditing.mending.rounds import AuditedTrajectory
from mqslam.auditing.revisits import share_torn_revisits
from mqslam.auditing.sizes import TORN_INFLATION, WINDOW
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.windows.windows import share_torn
from mqslam.config import Config, dump_yaml
from mqslam.errors import tolerate
from mqslam.execution.files import write_bytes
from mqslam.mapping.measures import Measures
from mqslam.report.content import (
    Figure,
    Frame,
    Gallery,
    Numbers,
    PagePart,
    Section,
    Table,
    TableRow,
    Tile,
)
from mqslam.report.explorers.audit_explorer import explore_audit
from mqslam.report.explorers.scene_data import ExplorerScene, make_scene
from mqslam.report.figures.audit_figures import EXPECTED, draw_heat_map, draw_inflation, draw_revisits
from mqslam.report.formatting import ABSENT, format_length, format_three_digits, format_value
from mqslam.report.inputs.audit_report import AuditReport
from mqslam.report.page import collect, name_values, section_of, tabulate_tests, verdict_in, version_in, write_page
from mqslam.report.places.bad_places import list_bad_places, write_bad_places
from mqslam.report.places.spots import rank_spot, spot_of_window
from mqslam.report.sections.audit_places import list_unmatched, list_worst, show_crops

_MEASURES: Final = {
    "map_entropy": ("mean map entropy", " nat"),
    "plane_variance": ("mean plane variance", " m²"),
    "joint_entropy": ("joint less separate entropy", " nat"),
    "grid_entropy": ("entropy per grid cell", " nat"),
}


def list_numbers(report: AuditReport) -> Numbers:
    """Returns the tables at the end of an audit's page."""
    summary = report.summary
    dataset = dict(section_of(summary, "dataset"))
    if isinstance(summary.get("trajectory"), str):
        dataset["trajectory"] = summary["trajectory"]
    cards = (
        name_values("Recording", dataset),
        name_values("Windows", section_of(summary, "windows")),
        name_values("Steps", section_of(summary, "steps")),
        name_values("Spans", section_of(summary, "spans")),
        name_values("Pooled corrections", section_of(summary, "pooled")),
        name_values("Revisits", section_of(summary, "revisits")),
    )
    note = "The usual measures of a map depend on the place as much as on the trajectory: none judges a map by itself."
    return Numbers("Measures", _tabulate_measures(report.audit), note, cards)


def _tabulate_measures(audit: Audit) -> Table | None:
    windows = audit.windows
    if not windows:
        return None
    rows = [
        TableRow("ψ per point", _list_quantiles([w.bend.psi for w in windows], "")),
        TableRow("ψ per point at its best", _list_quantiles([w.bend.psi_best for w in windows], "")),
        TableRow("points matched", _list_quantiles([100.0 * w.bend.matched for w in windows], " %")),
    ]
    for field in fields(Measures):
        label, unit = _MEASURES[field.name]
        rows.append(TableRow(label, _list_quantiles([getattr(w.measures, field.name) for w in windows], unit)))
    return Table(("of the windows", "5 %", "median", "95 %"), tuple(rows))


def _list_quantiles(values: list[float], unit: str) -> tuple[str, ...]:
    """Returns the 5 % quantile, median and 95 % quantile of the values that are known, as text."""
    known = [v for v in values if np.isfinite(v)]
    quantiles = np.quantile(known, [0.05, 0.5, 0.95]).tolist() if known else [None] * 3
    return tuple(format_value(quantile, unit) for quantile in quantiles)


_COMPARED: Final = (  # what is shown before and after mending: its name, where the summary has it, and its unit
    ("windows torn", "windows", "torn", ""),
    ("median inflation", "windows", "inflation_median", ""),
    ("jumps", "steps", "jumps", ""),
    ("spans torn", "spans", "torn", ""),
    ("revisits that are sure", "revisits", "sure", ""),
    ("revisits torn", "revisits", "torn", ""),
    ("median offset of two passes", "revisits", "median_m", " m"),
)


@dataclass(frozen=True, slots=True)
class AuditParts:
    """The parts of the page, as audit.html shows them."""

    tiles: PagePart[tuple[Tile, ...]]
    tests: PagePart[Section]
    mended: PagePart[Section]
    map: PagePart[Section]
    explorer: PagePart[ExplorerScene]
    worst: PagePart[Section]
    unmatched: PagePart[Section]
    crops: PagePart[Gallery]
    numbers: PagePart[Numbers]


def write_audit_pages(
    folder: Path,
    title: str,
    audit: Audit,
    sweeps: Sweeps,
    config: Config,
    summary: Mapping[str, Any],
    mended: AuditedTrajectory | None = None,
) -> list[str]:
    """Writes an audit's heat map, its bad places as files, and its page into an existing folder.

    Args:
        folder: the folder.
        title: heading of the page.
        audit: the windows and revisits, judged.
        sweeps: what was judged.
        config: all settings.
        summary: content of audit.json.
        mended: the mended trajectory and its audit; None where none was asked for.

    Returns:
        what could not be made, and why.

    Raises:
        OutputError: a file cannot be written.
    """
    failures: list[str] = []
    with tolerate("heatmap.png", failures):
        write_bytes(folder / "heatmap.png", draw_heat_map(sweeps, audit))
    with tolerate("the files of the bad places", failures):
        write_bad_places(folder, list_bad_places(sweeps, audit, config.audit))
    with tolerate("report.html", failures):
        warnings = (*summary["warnings"], *failures)
        report = AuditReport(title, summary, sweeps, audit, config, warnings, dump_yaml(config), mended)
        failures += write_audit_report(folder / "report.html", report)
    return failures


def write_audit_report(path: Path, report: AuditReport) -> list[str]:
    """Writes an audit's page as one HTML file that opens without a network.

    Args:
        path: the file.
        report: the audit as the page shows it.

    Returns:
        the parts that could not be drawn, and why; the page says it too.

    Raises:
        OutputError: the file cannot be written.
    """
    failures: list[str] = []
    sweeps, audit, settings = report.sweeps, report.audit, report.config.audit
    parts = AuditParts(
        mended=collect("the mended trajectory", lambda: _show_mended(report), failures),
        map=collect("the pictures of the map", lambda: _show_map(report), failures),
        tests=collect("the tests", lambda: tabulate_tests(report.summary), failures),
        tiles=collect("the first numbers", lambda: _make_tiles(report), failures),
        explorer=collect("the map to move in", lambda: make_scene(explore_audit(sweeps, audit, settings)), failures),
        worst=collect("the worst places", lambda: list_worst(report), failures),
        unmatched=collect("what could not be judged", lambda: list_unmatched(report), failures),
        crops=collect("the pictures of the worst places", lambda: show_crops(report), failures),
        numbers=collect("the tables", lambda: list_numbers(report), failures),
    )
    frame = Frame(
        title=report.title,
        settings_yaml=report.settings_yaml,
        version=version_in(report.summary),
        warnings=(*report.warnings, *failures),
        notes=report.notes,
        verdict=verdict_in(report.summary),
    )
    write_page(path, "audit.html", frame, parts)
    return failures


def _make_tiles(report: AuditReport) -> tuple[Tile, ...]:
    return (*_make_window_tiles(report), *_make_revisit_tiles(report))


def _make_window_tiles(report: AuditReport) -> tuple[Tile, ...]:
    windows = report.audit.windows
    if not windows:
        return ()
    torn = share_torn(windows)
    median = float(np.median([w.bend.inflation for w in windows]))
    decided = [window for window in windows if window.undecided is None]
    worst = max(map(spot_of_window, decided or windows), key=rank_spot).off_m
    share = Tile(ABSENT, f"of windows torn: none of {len(windows):,} could be decided")
    if torn.total:
        share = Tile(
            f"{100.0 * torn.count / torn.total:.1f} %",
            f"of windows torn: {torn.count:,} of {torn.total:,}, so that the true share may be {torn.describe_range()}",
        )
    return (
        share,
        Tile(
            format_three_digits(median),
            f"median inflation of a window, {EXPECTED:.2f} expected of a map that is right",
        ),
        Tile(format_length(worst), "worst window: how far its correction moves its points (RMS)"),
    )


def _make_revisit_tiles(report: AuditReport) -> tuple[Tile, ...]:
    revisits = report.audit.revisits
    sure = [r for r in revisits if r.revisit.sure]
    if not sure:
        reason = "it comes back to no place that would show its drift"
        if report.sweeps.track is None:
            reason = "without a trajectory nobody knows where it comes back"
        elif revisits:
            reason = f"of {len(revisits):,} places passed twice none is sure enough to judge"
        return (Tile(ABSENT, f"revisits torn: {reason}"),)
    torn = share_torn_revisits(revisits)
    return (
        Tile(
            f"{torn.count:,} of {torn.total:,}",
            f"revisits torn, of those that are sure, so that the true share may be {torn.describe_range()}",
        ),
        Tile(format_length(float(np.median([r.revisit.distance_m for r in sure]))), "median offset of two passes"),
    )


def _show_map(report: AuditReport) -> Section:
    settings, audit = report.config.audit, report.audit
    caption = (
        "the map in grey, the path in the colour of its windows' inflation: blue up to the threshold "
        f"{TORN_INFLATION:.1f}, orange beyond it; red where two passes of a place are off each other"
    )
    if any(window.undecided is not None for window in audit.windows):
        caption += "; grey where nothing could be decided"
    heat_map = Figure(draw_heat_map(report.sweeps, audit, opaque=False), "Heat map", caption)
    charts = []
    if audit.windows:
        bend = format_length(settings.bend_m)
        caption = f"torn are windows beyond the threshold that a correction moves by more than {bend}"
        charts.append(Figure(draw_inflation(audit), "Inflation of the windows", caption))
    if audit.revisits:
        caption = f"torn beyond the tolerance, or turned by more than {np.rad2deg(settings.torn_rad):.2g}°, where sure"
        if any(revisit.stated_covariance is not None for revisit in audit.revisits):
            caption = "torn where neither the measurement nor what the trajectory claims to know explains the offset"
        charts.append(Figure(draw_revisits(report.sweeps, audit, settings), "Offset of the revisits", caption))
    note = (
        f"Every {WINDOW} sweeps are compared with the best map that the same returns can make. Inflation is the "
        "correction that leads there, squared, in units of its own covariance. No ground truth takes part."
    )
    return Section("Map", (note,), (heat_map,), tuple(charts))


def _show_mended(report: AuditReport) -> Section | None:
    """Returns the given trajectory and the mended one side by side; None where none was asked for."""
    before, after = report.summary, section_of(report.summary, "mended")
    if report.mended is None or not after:
        return None
    figures = (
        Figure(draw_heat_map(report.sweeps, report.audit, opaque=False), "As it was given"),
        Figure(draw_heat_map(report.mended.sweeps, report.mended.audit, opaque=False), "Mended"),
    )
    rows = [TableRow("verdict", tuple(section_of(shown, "verdict")["status"] for shown in (before, after)))]
    for label, section, key, unit in _COMPARED:
        values = (section_of(shown, section).get(key) for shown in (before, after))
        rows.append(TableRow(label, tuple(format_value(value, unit) for value in values)))
    table = Table(("", "as it was given", "mended"), tuple(rows))
    verdict = section_of(after, "verdict")
    why = f"The mended trajectory is judged {verdict['status']}: {'; '.join(verdict['reasons'])}."
    return Section("Mended", (str(after["sentence"]), why), figures, table=table)
