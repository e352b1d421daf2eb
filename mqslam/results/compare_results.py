"""What a comparison leaves: a folder per row, and their numbers as JSON, CSV and a table for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mqslam.auditing.verdict import Share, VerdictStatus
from mqslam.auditing.windows import WindowAudit, torn_threshold
from mqslam.comparison.comparison import Comparison
from mqslam.comparison.judgement import Judged
from mqslam.comparison.rows import Row
from mqslam.config import Config, dump_yaml
from mqslam.execution.files import write_json, write_text
from mqslam.formats.trajectories import write_kitti
from mqslam.formats.tum import write_tum
from mqslam.results.run_results import format_measurements, write_marginals
from mqslam.results.summary_files import format_csv
from mqslam.version import __version__

# columns of the table: key in a row of compare.json, head, format
_WITH_TRUTH = (
    ("drift_percent", "drift [%]", "{:.3f}"),
    ("drift_deg_per_100m", "[deg/100 m]", "{:.3f}"),
    ("ate_rmse_m", "ATE [m]", "{:.3f}"),
    ("rpe_v_rms", "speed error [m/s]", "{:.3f}"),
    ("odometry_drift_percent", "before back end [%]", "{:.3f}"),
)
_WITHOUT_TRUTH = (
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


def summarise(comparison: Comparison) -> dict[str, Any]:
    """Returns the content of compare.json."""
    recording, settings = comparison.recording, comparison.settings
    judged = comparison.judged
    return {
        "mqslam_version": __version__,
        "dataset": {
            "format": recording.format,
            "path": str(recording.path),
            "revolutions": len(recording),
            "duration_s": recording.duration_s,
            "compared": comparison.compared,
        },
        "doppler_beta": comparison.doppler_beta,
        "threshold": torn_threshold(settings.audit),
        "warnings": list(comparison.warnings),
        "rows": [_list_row(row, judged.get(row.name), len(recording), settings) for row in comparison.rows],
        "agreement": [
            {"row": a, "against": b, "rmse_m": e.ate_rmse_m, "drift_percent": e.drift_percent, "speed_rms": e.rpe_v_rms}
            for a, b, e in comparison.agreement
        ],
        "places": [{"t0": p.t0, "t1": p.t1, "apart_m": p.apart_m} for p in comparison.places],
    }


def _list_row(row: Row, judged: Judged | None, scans: int, settings: Config) -> dict[str, Any]:
    """Returns a row's numbers; a row that failed has its name and failure only."""
    if judged is None:
        return {"name": row.name, "failure": row.failure}
    windows, sure = judged.audit.windows, [r for r in judged.audit.revisits if r.revisit.sure]
    torn = Share(sum(w.torn for w in windows), len(windows))
    truth, before = judged.after, judged.before
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
        "verdict": judged.audit.status,
        "reasons": "; ".join(judged.audit.reasons),
        "psi_per_point": judged.psi_per_point,
        "matched": judged.matched,
        "inflation": _find_median_inflation(windows, settings.audit.overlap),
        "windows": len(windows),
        "windows_torn": torn.count / torn.total if windows else None,
        "windows_torn_at_least": torn.lower_bound(settings.verdict.confidence),
        "windows_torn_at_most": torn.upper_bound(settings.verdict.confidence),
        "revisits": len(sure),
        "revisits_torn": sum(r.torn for r in sure),
        "revisit_m": float(np.median([r.revisit.distance_m for r in sure])) if sure else None,
        "loops": row.loops if row.measurements else None,
        "loops_rejected": row.loops_rejected if row.measurements else None,
        "measure_s": row.measure_s,
        "ms_per_revolution": None if row.measure_s is None else 1e3 * row.measure_s / scans,
        "back_end_s": row.back_end_s,
        "peak_rss_mb": row.peak_rss_mb,
    }


def _find_median_inflation(windows: Sequence[WindowAudit], overlap: float) -> float | None:
    """Returns the median inflation; None where most windows do not overlap even at their best, so that it means nothing."""
    values = [w.bend.inflation if w.bend.matched_best >= overlap else np.inf for w in windows]
    median = float(np.median(values)) if values else np.inf
    return median if np.isfinite(median) else None


def tabulate(summary: Mapping[str, Any]) -> list[list[str]]:
    """Returns the table as a person reads it, its head first; columns that no row has are left out."""
    rows: list[dict[str, Any]] = summary["rows"]
    shown = [c for c in (*_WITH_TRUTH, *_WITHOUT_TRUTH) if any(row.get(c[0]) is not None for row in rows)]
    cells = [["", *(head for _, head, _ in shown)]]
    for row in rows:
        if row["failure"] is not None:
            cells.append([row["name"], f"could not run: {row['failure']}", *[""] * (len(shown) - 1)])
            continue
        cells.append([row["name"], *(_format_cell(row[key], form) for key, _, form in shown)])
    return cells


def _format_cell(value: Any, form: str) -> str:
    """Returns a value of the table as text: empty where there is none, and a verdict unchanged."""
    if value is None or isinstance(value, VerdictStatus):
        return str(value or "")
    return form.format(value)


def write_compare(folder: Path, comparison: Comparison, summary: Mapping[str, Any]) -> None:
    """Writes every result file of a comparison but its pictures and its page into an existing folder.

    Args:
        folder: the folder.
        comparison: the finished comparison.
        summary: content of compare.json.

    Raises:
        OutputError: a file cannot be written.
    """
    for row in comparison.rows:
        if row.trajectory is not None:
            _write_row(folder / row.name, row)
    write_text(folder / "config.yaml", dump_yaml(comparison.settings))
    write_text(folder / "compare.csv", format_csv(summary["rows"]))
    write_json(folder / "compare.json", summary)


def _write_row(folder: Path, row: Row) -> None:
    """Writes what a row leaves into a folder of its own."""
    assert row.trajectory is not None and row.odometry is not None
    folder.mkdir()
    write_tum(folder / "trajectory.tum", row.trajectory)
    write_kitti(folder / "trajectory.kitti", row.trajectory)
    write_text(folder / "times.txt", "".join(f"{t / 1e6:.6f}\n" for t in row.trajectory.stamps_us.tolist()))
    if row.measurements:
        write_tum(folder / "odometry.tum", row.odometry)
        write_text(folder / "measurements.csv", format_measurements(row.measurements))
    if row.covariances is not None:
        write_marginals(folder / "covariances.csv", row.trajectory, row.covariances)
