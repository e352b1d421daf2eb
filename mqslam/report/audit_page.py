"""The report of an audit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import numpy as np

from mqslam.audit.judge import Audit
from mqslam.audit.measures import Measures
from mqslam.audit.sweeps import Sweeps
from mqslam.audit.verdict import Share
from mqslam.config import Config, dump_yaml
from mqslam.errors import tolerate
from mqslam.execution.files import write_bytes, write_text
from mqslam.report.audit_figures import EXPECTED, heat_map, inflation_figure, revisit_figure, threshold
from mqslam.report.crops import Crop, crop_pictures, crops
from mqslam.report.explorers.audit_explorer import audit_explorer
from mqslam.report.explorers.explorer import explorer
from mqslam.report.page import (
    ABSENT,
    captioned,
    draw,
    grid,
    named_card,
    note,
    number,
    page,
    picture,
    section,
    tiles,
    titled_card,
    verdict_badge,
    warning_box,
)
from mqslam.report.spots import direction, length, of_window, rank, three, worst_spots

__all__ = ["AuditReport", "Crop", "crops", "heat_map", "write_audit_pages", "write_audit_report"]

_MEASURES: Final = {
    "map_entropy": ("mean map entropy", " nat"),
    "plane_variance": ("mean plane variance", " m²"),
    "joint_entropy": ("joint less separate entropy", " nat"),
    "grid_entropy": ("entropy per grid cell", " nat"),
}


@dataclass(frozen=True, slots=True)
class AuditReport:
    """An audit as its report shows it.

    Args:
        title: heading of the page.
        summary: content of audit.json; a key that is absent or None is shown as not available.
        sweeps: what was judged.
        audit: what came of it.
        config: all settings.
        warnings: what the reader has to know before the numbers.
        settings_yaml: every setting used, as in config.yaml.
    """

    title: str
    summary: Mapping[str, Any]
    sweeps: Sweeps
    audit: Audit
    config: Config
    warnings: tuple[str, ...]
    settings_yaml: str


def write_audit_pages(
    folder: Path, title: str, found: Audit, sweeps: Sweeps, config: Config, summary: Mapping[str, Any]
) -> list[str]:
    """Write an audit's heat map and its report into an existing folder.

    Returns:
        what could not be made, and why.

    Raises:
        OutputError: a file cannot be written.
    """
    failures: list[str] = []
    with tolerate("heatmap.png", failures):
        write_bytes(folder / "heatmap.png", heat_map(sweeps, found, config.audit))
    with tolerate("report.html", failures):
        warnings = (*summary["warnings"], *failures)
        report = AuditReport(title, summary, sweeps, found, config, warnings, dump_yaml(config))
        failures += write_audit_report(folder / "report.html", report)
    return failures


def write_audit_report(path: Path, report: AuditReport) -> list[str]:
    """Write an audit's report as one HTML file that opens without a network.

    Returns:
        what of it could not be drawn, and why; the report says it too.

    Raises:
        OutputError: the file cannot be written.
    """
    failures: list[str] = []
    settings = report.config.audit
    still = draw("the pictures of the map", lambda: _map(report), failures)
    parts = (
        draw("the first numbers", lambda: _tiles(report), failures),
        draw(
            "the map to move in",
            lambda: explorer(audit_explorer(report.sweeps, report.audit, settings), still),
            failures,
            still,
        ),
        draw("the worst places", lambda: _worst(report), failures),
        draw("the pictures of the worst places", lambda: _crops(crops(report.sweeps, report.audit, settings)), failures),
        draw("the tables", lambda: _tables(report), failures),
    )
    head = (warning_box([*report.warnings, *failures]), verdict_badge(section(report.summary, "verdict")))
    write_text(path, page(report.title, head, parts, report.settings_yaml, report.summary))
    return failures


def _tiles(report: AuditReport) -> str:
    audit, settings = report.audit, report.config.verdict
    windows = audit.windows
    sure = [r for r in audit.revisits if r.revisit.sure]
    torn = Share(sum(w.torn for w in windows), len(windows))
    values = []
    if windows:
        middle = float(np.median([w.bend.inflation for w in windows]))
        worst = max(map(of_window, windows), key=rank).off_m
        values += [
            (
                f"{100.0 * torn.count / torn.total:.1f} %",
                f"of windows torn: {torn.count:,} of {torn.total:,}, so that the true share may be "
                f"{torn.range_text(settings)}",
            ),
            (three(middle), f"median inflation of a window, {EXPECTED:.2f} expected of a map that is right"),
            (length(worst), "worst window: how far its correction moves its points (RMS)"),
        ]
    off = [r for r in sure if r.torn]
    if not sure:
        said = "it comes back to no place that would show its drift"
        if audit.revisits:
            said = f"of {len(audit.revisits):,} places passed twice none is sure enough to judge"
        return tiles([*values, (ABSENT, f"revisits torn: {said}")])
    values += [
        (
            f"{len(off):,} of {len(sure):,}",
            "revisits torn, of those that are sure, so that the true share may be "
            f"{Share(len(off), len(sure)).range_text(settings)}",
        ),
        (length(float(np.median([r.revisit.distance_m for r in sure]))), "median offset of two passes"),
    ]
    return tiles(values)


def _map(report: AuditReport) -> str:
    settings, audit = report.config.audit, report.audit
    caption = (
        "the map in grey, the path in the colour of its windows' inflation: blue up to the threshold "
        f"{threshold(settings):.1f}, orange beyond it; red where two passes of a place are off each other"
    )
    pictures = picture(heat_map(report.sweeps, audit, settings, opaque=False), "Heat map", caption)
    charts = ""
    if audit.windows:
        said = f"torn are windows beyond the threshold that a correction moves by more than {length(settings.bend_m)}"
        charts += picture(inflation_figure(audit, settings), "Inflation of the windows", said)
    if audit.revisits:
        said = f"torn beyond the tolerance, or turned by more than {np.rad2deg(settings.torn_rad):.2g}°, where sure"
        charts += picture(revisit_figure(report.sweeps, audit, settings), "Offset of the revisits", said)
    stacked = f'<div class="stack">{charts}</div>' if charts else ""
    explained = note(
        f"Every {settings.window} sweeps are held against the best map that the same returns can make: inflation is the "
        "correction that takes, squared, in units of its own covariance. No ground truth takes part."
    )
    return f'<h2>Map</h2>{explained}<div class="pair">{pictures}{stacked}</div>'


def _worst(report: AuditReport) -> str:
    rows = [
        (
            f"{k}",
            spot.kind,
            spot.time,
            spot.place,
            length(spot.off_m),
            direction(spot.correction),
            three(spot.inflation),
            "yes" if spot.torn else "no",
        )
        for k, spot in enumerate(worst_spots(report.sweeps, report.audit), 1)
    ]
    if not rows:
        return ""
    head = ("", "what", "time", "place", "off by", "correction", "inflation", "torn")
    explained = note(
        "Torn places by how far they are off, then the windows of the largest inflation; well apart from each other. "
        "Corrections are given as the sensor would say them: of a window's end against its begin, of a revisit's later pass."
    )
    return f'<h2>Worst places</h2>{explained}<section class="card">{grid(head, rows)}</section>'


def _crops(shown: tuple[Crop, ...]) -> str:
    if not shown:
        return ""
    cards = []
    for k, crop in enumerate(shown, 1):
        before, after = crop_pictures(crop)
        title = f"{k}. {crop.title}"
        pictures = captioned(before, "as it is", f"{title}, before") + captioned(after, "corrected", f"{title}, after")
        cards.append(titled_card(title, note(crop.text) + f'<div class="beside">{pictures}</div>'))
    explained = note(
        "The points where the correction shows the most, seen from the sensor, ahead to the right. Blue is the earlier "
        "pass or the window's first sweep, orange the later pass or its last sweep: a wall of two colours is doubled."
    )
    return f'<h2>Before and after</h2>{explained}<div class="halves">{"".join(cards)}</div>'


def _tables(report: AuditReport) -> str:
    summary = report.summary
    dataset = dict(section(summary, "dataset"))
    if isinstance(summary.get("trajectory"), str):
        dataset["trajectory"] = summary["trajectory"]
    cards = [
        _measures(report.audit),
        named_card("Recording", dataset),
        named_card("Windows", section(summary, "windows")),
        named_card("Revisits", section(summary, "revisits")),
    ]
    return f'<h2>Numbers</h2><div class="tables">{"".join(cards)}</div>'


def _measures(audit: Audit) -> str:
    windows = audit.windows
    if not windows:
        return ""
    rows = [
        ("ψ per point", *_quantiles([w.bend.psi for w in windows], "")),
        ("ψ per point at its best", *_quantiles([w.bend.psi_best for w in windows], "")),
        ("points matched", *_quantiles([100.0 * w.bend.matched for w in windows], " %")),
    ]
    for field in fields(Measures):
        label, unit = _MEASURES[field.name]
        rows.append((label, *_quantiles([getattr(w.measures, field.name) for w in windows], unit)))
    table = grid(("of the windows", "5 %", "median", "95 %"), rows)
    said = "The field's measures depend on the place as much as on the trajectory: none of them judges a map by itself."
    return titled_card("Measures", table + note(said), wide=True)


def _quantiles(values: list[float], unit: str) -> tuple[str, str, str]:
    """The 5 % quantile, median and 95 % quantile as text."""
    known = [v for v in values if np.isfinite(v)]
    low, middle, high = np.quantile(known, [0.05, 0.5, 0.95]).tolist() if known else (None, None, None)
    return number(low, unit), number(middle, unit), number(high, unit)
