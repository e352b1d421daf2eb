"""What a batch leaves besides its runs: their numbers in three forms."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mqslam
from mqslam.audit.verdict import VerdictStatus
from mqslam.commands.batch_plan import Order
from mqslam.commands.batch_schedule import Outcome
from mqslam.core.trajectory import Trajectory, read_tum
from mqslam.errors import OutputError, tolerate
from mqslam.execution.files import write_json, write_text
from mqslam.report.batch_page import write_batch_report


def check_batch(out: Path, *, force: bool) -> None:
    """Make the folder of a batch, or see that it is one, before hours are spent on it.

    Raises:
        OutputError: it holds the results of another command, is a file or cannot be made.
    """
    others = (out / "report.html").exists() and not (out / "batch.json").exists()
    if others and not force:
        raise OutputError(f"{out}: holds other results; choose another --out or give --force to write into it")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be made ({error.strerror}); choose another --out") from error


def summarise(orders: Sequence[Order], outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """The content of batch.json."""
    runs = [_row(order, outcome) for order, outcome in zip(orders, outcomes, strict=True)]
    states = [run["verdict"] or "failed" for run in runs]
    return {
        "mqslam_version": mqslam.__version__,
        "counts": {state: states.count(state) for state in (*VerdictStatus, "failed")},
        "kept": sum(outcome.kept for outcome in outcomes),
        "duration_s": sum(run["duration_s"] or 0.0 for run in runs),
        "length_m": sum(run["length_m"] or 0.0 for run in runs),
        "runtime_s": sum(run["runtime_s"] or 0.0 for run in runs),
        "warnings": [],
        "runs": runs,
    }


def _row(order: Order, outcome: Outcome) -> dict[str, Any]:
    """A run's numbers; None for all that a failed one has not."""
    found = outcome.summary or {}
    dataset, psi, factors = found.get("dataset", {}), found.get("psi", {}), found.get("factors", {})
    verdict, evaluation = found.get("verdict", {}), found.get("evaluation") or {}
    return {
        "name": order.name,
        "data": str(order.data),
        "frontend": order.frontend,
        "verdict": verdict.get("status"),
        "reasons": "; ".join(verdict.get("reasons", ())),
        "failure": outcome.failure,
        "revolutions": dataset.get("revolutions"),
        "unread": dataset.get("unread"),
        "duration_s": dataset.get("duration_s"),
        "length_m": dataset.get("length_m"),
        "psi_per_point_odometry": psi.get("per_point_odometry"),
        "psi_per_point": psi.get("per_point_optimised"),
        "matched": psi.get("matched_optimised"),
        "loops": factors.get("loop"),
        "ate_rmse_m": evaluation.get("ate_rmse_m"),
        "drift_percent": evaluation.get("drift_percent"),
        "drift_deg_per_100m": evaluation.get("drift_deg_per_100m"),
        "runtime_s": found.get("runtime_s", {}).get("total"),
        "trajectory": f"{order.name}/trajectory.tum" if outcome.summary else None,
        "report": f"{order.name}/report.html" if outcome.summary else None,
    }


def write_batch(out: Path, title: str, summary: dict[str, Any], plan: str) -> None:
    """Write the files over all runs into the batch's folder, where the runs' own folders are.

    What the report needs and cannot have is a warning, which is added to those of the summary.

    Args:
        out: the folder.
        title: heading of the report.
        summary: content of batch.json.
        plan: text of RUNS.yaml.

    Raises:
        OutputError: a file cannot be written.
    """
    rows: list[dict[str, Any]] = summary["runs"]
    warnings: list[str] = summary["warnings"]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows(rows)
    write_text(out / "batch.csv", text.getvalue())
    write_json(out / "batch.json", summary)
    tracks: dict[str, Trajectory] = {}
    for row in rows:
        if row["trajectory"]:
            with tolerate(f"the picture of {row['name']}", warnings):  # a kept run may have lost its file since
                tracks[row["name"]] = read_tum(out / row["trajectory"])
    with tolerate("report.html", warnings):
        warnings += write_batch_report(out / "report.html", title, summary, tracks, warnings, plan)
    if warnings:
        write_json(out / "batch.json", summary)
