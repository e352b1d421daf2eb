"""What an audit leaves: its numbers as JSON and CSV, a heat map and a report."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import mqslam
from mqslam.audit.judge import Audit
from mqslam.audit.revisits import RevisitAudit
from mqslam.audit.sweeps import Sweeps
from mqslam.audit.verdict import Share
from mqslam.audit.windows import WindowAudit, torn_threshold
from mqslam.config import AuditConfig, Config, VerdictConfig, dump_yaml
from mqslam.execution.files import write_json, write_text


def summarise(
    found: Audit,
    sweeps: Sweeps,
    settings: AuditConfig,
    bounds: VerdictConfig,
    dataset: Mapping[str, Any],
    trajectory: str,
    warnings: Sequence[str] = (),
) -> dict[str, Any]:
    """The content of audit.json.

    Args:
        found: what came of the audit.
        sweeps: what was judged.
        settings: of the audit.
        bounds: settings of the verdict.
        dataset: format and path of what was audited.
        trajectory: where the trajectory came from.
        warnings: what a reader has to know before the numbers.
    """
    sure = [r for r in found.revisits if r.revisit.sure]
    torn = Share(sum(w.torn for w in found.windows), len(found.windows))
    off = Share(sum(r.torn for r in sure), len(sure))
    confidence = bounds.confidence
    inflation = [w.bend.inflation for w in found.windows]
    return {
        "mqslam_version": mqslam.__version__,
        "dataset": {
            **dataset,
            "sweeps": len(sweeps),
            "duration_s": float(sweeps.times[-1] - sweeps.times[0] + sweeps.revolution_s),
            "length_m": float(sweeps.travelled[-1]),
            "points": len(sweeps.points),
        },
        "trajectory": trajectory,
        "verdict": {"status": found.status, "reasons": found.reasons},
        "threshold": torn_threshold(settings),
        "bend_m": settings.bend_m,
        "windows": {
            "count": torn.total,
            "torn": torn.count,
            "torn_share_at_least": torn.at_least(confidence),
            "torn_share_at_most": torn.at_most(confidence),
            "inflation_median": float(np.median(inflation)) if inflation else None,
            "psi_per_point": _mean([w.bend.psi for w in found.windows]),
            "matched": _mean([w.bend.matched for w in found.windows]),
        },
        "revisits": {
            "count": len(found.revisits),
            "sure": off.total,
            "torn": off.count,
            "torn_share_at_least": off.at_least(confidence),
            "torn_share_at_most": off.at_most(confidence),
            "median_m": float(np.median([r.revisit.distance_m for r in sure])) if sure else None,
            "worst_m": max((r.revisit.distance_m for r in sure if r.torn), default=None),
        },
        "warnings": list(warnings),
        "per_window": [_window(w) for w in found.windows],
        "per_revisit": [_revisit(r, sweeps) for r in found.revisits],
    }


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _window(window: WindowAudit) -> dict[str, Any]:
    bend, beside = window.bend, window.measures
    span = window.t1 - window.t0
    sigma = np.sqrt(np.diag(bend.covariance))
    return {
        "t0": window.t0,
        "t1": window.t1,
        "x": float(window.pose[0]),
        "y": float(window.pose[1]),
        "yaw": float(window.pose[2]),
        "torn": window.torn,
        "inflation": bend.inflation,
        "dx": float(bend.correction[0]),
        "dy": float(bend.correction[1]),
        "dyaw": float(bend.correction[2]),
        "sigma_x": float(sigma[0]),
        "sigma_y": float(sigma[1]),
        "sigma_yaw": float(sigma[2]),
        "dv": float(bend.correction[0] / span),
        "domega": float(bend.correction[2] / span),
        "size_m": bend.size_m,
        "psi_per_point": bend.psi,
        "psi_per_point_best": bend.psi_best,
        "matched": bend.matched,
        "matched_best": bend.matched_best,
        "points": bend.points,
        "map_entropy": beside.map_entropy,
        "plane_variance": beside.plane_variance,
        "joint_entropy": beside.joint_entropy,
        "grid_entropy": beside.grid_entropy,
    }


def _revisit(found: RevisitAudit, sweeps: Sweeps) -> dict[str, Any]:
    revisit = found.revisit
    pose, sigma = sweeps.poses[revisit.later], np.sqrt(np.diag(revisit.covariance))
    return {
        "t_earlier": float(sweeps.times[revisit.earlier]),
        "t_later": float(sweeps.times[revisit.later]),
        "x": float(pose[0]),
        "y": float(pose[1]),
        "yaw": float(pose[2]),
        "torn": found.torn,
        "sure": revisit.sure,
        "dx": float(revisit.offset[0]),
        "dy": float(revisit.offset[1]),
        "dyaw": float(revisit.offset[2]),
        "sigma_x": float(sigma[0]),
        "sigma_y": float(sigma[1]),
        "sigma_yaw": float(sigma[2]),
        "inflation": revisit.inflation,
        "matched": revisit.matched,
        "psi_per_point": revisit.psi,
        "psi_per_point_best": revisit.psi_best,
    }


def write_audit(folder: Path, config: Config, summary: Mapping[str, Any]) -> None:
    """Write every result file of an audit but its pictures and its report into an existing folder.

    Raises:
        OutputError: a file cannot be written.
    """
    write_text(folder / "config.yaml", dump_yaml(config))
    write_text(folder / "audit.csv", _csv(summary["per_window"]))
    write_text(folder / "revisits.csv", _csv(summary["per_revisit"]))
    write_json(folder / "audit.json", summary)


def add_warnings(folder: Path, summary: dict[str, Any], warnings: Sequence[str]) -> None:
    """Add to a summary that is written what could not be written after it."""
    if warnings:
        summary["warnings"] += warnings
        write_json(folder / "audit.json", summary)


def _csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows of numbers under their names; empty without any."""
    if not rows:
        return ""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({key: f"{value:.9g}" if isinstance(value, float) else value for key, value in row.items()})
    return text.getvalue()
