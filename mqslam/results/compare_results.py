"""What a comparison leaves: a folder per row, a table in several forms, pictures and a report."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import mqslam
from mqslam.audit.verdict import Share, VerdictStatus
from mqslam.audit.windows import WindowAudit, torn_threshold
from mqslam.compare.judgement import Judged, Place
from mqslam.compare.rows import Row
from mqslam.config import AuditConfig, Config, VerdictConfig, dump_yaml
from mqslam.core.recording import Recording
from mqslam.evaluation import Evaluation
from mqslam.execution.files import write_json, write_text
from mqslam.formats.trajectories import write_kitti
from mqslam.formats.tum import write_tum
from mqslam.results.run_results import measurements_csv

# column of the table: key in a row of compare.json, head, how it is printed
WITH_TRUTH = (
    ("drift_percent", "drift [%]", "{:.3f}"),
    ("drift_deg_per_100m", "[deg/100 m]", "{:.3f}"),
    ("ate_rmse_m", "ATE [m]", "{:.3f}"),
    ("rpe_v_rms", "speed error [m/s]", "{:.3f}"),
    ("odometry_drift_percent", "before back end [%]", "{:.3f}"),
)
WITHOUT_TRUTH = (
    ("psi_per_point", "psi per point", "{:.4f}"),
    ("matched", "matched", "{:.1%}"),
    ("verdict", "verdict", "{}"),
    ("inflation", "inflation", "{:.3g}"),
    ("windows_torn", "windows torn", "{:.1%}"),
    ("revisit_m", "revisits apart [m]", "{:.3f}"),
    ("loops", "loops", "{}"),
    ("ms_per_revolution", "time [ms/rev]", "{:.1f}"),
    ("back_end_s", "back end [s]", "{:.1f}"),
    ("peak_rss_mb", "memory [MB]", "{:.0f}"),
)


def summarise(
    recording: Recording,
    doppler_beta: float,
    settings: AuditConfig,
    bounds: VerdictConfig,
    rows: Sequence[Row],
    judged: Mapping[str, Judged],
    places: Sequence[Place],
    agreement: Sequence[tuple[str, str, Evaluation]],
    revolutions: int,
    warnings: Sequence[str] = (),
) -> dict[str, Any]:
    """The content of compare.json; `revolutions` are those that every row covers."""
    return {
        "mqslam_version": mqslam.__version__,
        "dataset": {
            "format": recording.format,
            "path": str(recording.path),
            "revolutions": len(recording),
            "duration_s": recording.duration_s,
            "compared": revolutions,
        },
        "doppler_beta": doppler_beta,
        "threshold": torn_threshold(settings),
        "warnings": list(warnings),
        "rows": [_row(row, judged.get(row.name), len(recording), settings, bounds) for row in rows],
        "agreement": [
            {"row": a, "against": b, "rmse_m": e.ate_rmse_m, "drift_percent": e.drift_percent, "speed_rms": e.rpe_v_rms}
            for a, b, e in agreement
        ],
        "places": [{"t0": p.t0, "t1": p.t1, "apart_m": p.apart_m} for p in places],
    }


def _row(row: Row, found: Judged | None, revolutions: int, settings: AuditConfig, bounds: VerdictConfig) -> dict[str, Any]:
    if found is None:
        return {"name": row.name, "failure": row.failure}
    windows, sure = found.audit.windows, [r for r in found.audit.revisits if r.revisit.sure]
    torn = Share(sum(w.torn for w in windows), len(windows))
    truth, before = found.after, found.before
    return {
        "name": row.name,
        "failure": None,
        "drift_percent": truth and truth.drift_percent,
        "drift_deg_per_100m": truth and truth.drift_deg_per_100m,
        "ate_rmse_m": truth and truth.ate_rmse_m,
        "rpe_v_rms": truth and truth.rpe_v_rms,
        "rpe_w_rms": truth and truth.rpe_w_rms,
        "odometry_drift_percent": before and before.drift_percent,
        "odometry_drift_deg_per_100m": before and before.drift_deg_per_100m,
        "odometry_ate_rmse_m": before and before.ate_rmse_m,
        "verdict": found.audit.status,
        "reasons": "; ".join(found.audit.reasons),
        "psi_per_point": found.psi_per_point,
        "matched": found.matched,
        "inflation": _inflation(windows, settings.overlap),
        "windows": len(windows),
        "windows_torn": torn.count / torn.total if windows else None,
        "windows_torn_at_least": torn.at_least(bounds.confidence),
        "windows_torn_at_most": torn.at_most(bounds.confidence),
        "revisits": len(sure),
        "revisits_torn": sum(r.torn for r in sure),
        "revisit_m": float(np.median([r.revisit.distance_m for r in sure])) if sure else None,
        "loops": row.loops if row.measurements else None,
        "loops_rejected": row.loops_rejected if row.measurements else None,
        "measure_s": row.measure_s,
        "ms_per_revolution": None if row.measure_s is None else 1e3 * row.measure_s / revolutions,
        "back_end_s": row.back_end_s,
        "peak_rss_mb": row.peak_rss_mb,
    }


def _inflation(windows: Sequence[WindowAudit], overlap: float) -> float | None:
    """The median inflation; None where most windows do not overlap even at their best and have none to speak of."""
    values = [w.bend.inflation if w.bend.matched_best >= overlap else np.inf for w in windows]
    median = float(np.median(values)) if values else np.inf
    return median if np.isfinite(median) else None


def table(summary: Mapping[str, Any]) -> list[list[str]]:
    """The table as a person reads it, its head first; columns that no row has are left out."""
    rows: list[dict[str, Any]] = summary["rows"]
    shown = [c for c in (*WITH_TRUTH, *WITHOUT_TRUTH) if any(row.get(c[0]) is not None for row in rows)]
    cells = [["", *(head for _, head, _ in shown)]]
    for row in rows:
        if row["failure"] is not None:
            cells.append([row["name"], f"could not run: {row['failure']}", *[""] * (len(shown) - 1)])
            continue
        cells.append([row["name"], *(_cell(row[key], form) for key, _, form in shown)])
    return cells


def _cell(value: Any, form: str) -> str:
    """A value of the table as text; nothing where there is none, and a verdict as what it is."""
    if value is None or isinstance(value, VerdictStatus):
        return value or ""
    return form.format(value)


def write_compare(folder: Path, config: Config, summary: Mapping[str, Any], rows: Sequence[Row]) -> None:
    """Write every result file of a comparison but its pictures and its report into an existing folder.

    Raises:
        OutputError: a file cannot be written.
    """
    for row in rows:
        if row.trajectory is not None:
            _write_row(folder / row.name, row)
    write_text(folder / "config.yaml", dump_yaml(config))
    write_text(folder / "compare.csv", _csv(summary))
    write_json(folder / "compare.json", summary)


def add_warnings(folder: Path, summary: dict[str, Any], warnings: Sequence[str]) -> None:
    """Add to a summary that is written what could not be written after it."""
    if warnings:
        summary["warnings"] += warnings
        write_json(folder / "compare.json", summary)


def _write_row(folder: Path, row: Row) -> None:
    assert row.trajectory is not None and row.odometry is not None
    folder.mkdir()
    write_tum(folder / "trajectory.tum", row.trajectory)
    write_kitti(folder / "trajectory.kitti", row.trajectory)
    write_text(folder / "times.txt", "".join(f"{t / 1e6:.6f}\n" for t in row.trajectory.stamps_us.tolist()))
    if row.measurements:
        write_tum(folder / "odometry.tum", row.odometry)
        write_text(folder / "measurements.csv", measurements_csv(row.measurements))


def _csv(summary: Mapping[str, Any]) -> str:
    """All numbers of the rows; an empty cell where there is none."""
    rows: list[dict[str, Any]] = summary["rows"]
    keys = max((list(row) for row in rows), key=len)
    text = io.StringIO()
    writer = csv.DictWriter(text, keys, lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
