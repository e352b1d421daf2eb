"""The numbers at the end of an audit's page."""

from __future__ import annotations

from dataclasses import fields
from typing import Final

import numpy as np

from mqslam.auditing.judge import Audit
from mqslam.mapping.measures import Measures
from mqslam.report.content import Numbers, Table, TableRow
from mqslam.report.formatting import format_value
from mqslam.report.inputs.audit_report import AuditReport
from mqslam.report.page import name_values, section_of

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
