"""What an audit leaves: its numbers as JSON and CSV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from mqslam.auditing.findings import SCALE_WARN
from mqslam.auditing.judge import Audit
from mqslam.auditing.mending.rounds import Mended
from mqslam.auditing.revisits import share_torn_revisits
from mqslam.auditing.sizes import TORN_INFLATION, WINDOW
from mqslam.auditing.spans.pooled import Pooled
from mqslam.auditing.speeds import contradicts
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.verdict import CONFIDENCE, Finding, VerdictStatus, verdict_of
from mqslam.auditing.windows.windows import share_torn
from mqslam.config import AuditConfig, Config, VerdictConfig, dump_yaml
from mqslam.core.statistics import find_smallest
from mqslam.core.wording import count_of
from mqslam.execution.files import write_json, write_text
from mqslam.results.audit_rows import (
    RevisitRow,
    SpanRow,
    StepRow,
    WindowRow,
    list_revisit,
    list_span,
    list_step,
    list_window,
)
from mqslam.results.run_log import format_log, list_verdict
from mqslam.results.summary_files import format_csv
from mqslam.results.unjudged import list_uncovered, list_unjudged
from mqslam.version import __version__

# what audit.json says once, of the given and of the mended trajectory
_OF_BOTH: Final = ("mqslam_version", "dataset", "trajectory", "threshold", "bend_m", "extrinsics", "warnings")


def summarise(
    audit: Audit,
    sweeps: Sweeps,
    settings: AuditConfig,
    bounds: VerdictConfig,
    dataset: Mapping[str, Any],
    trajectory: str | None,
    warnings: Sequence[str] = (),
    extrinsics: tuple[float, float, float] | None = None,
) -> dict[str, Any]:
    """Returns the content of audit.json.

    Args:
        audit: the windows and revisits, judged.
        sweeps: what was judged.
        settings: settings of the audit.
        bounds: settings of the verdict.
        dataset: format and path of what was audited.
        trajectory: where the trajectory came from; None for a cloud without one.
        warnings: what a reader has to know before the numbers.
        extrinsics: x, y [m], yaw [degrees] of the sensor in the frame of which the trajectory was given, if it was stated.
    """
    sure = [r for r in audit.revisits if r.revisit.sure]
    torn = share_torn(audit.windows)
    off = share_torn_revisits(audit.revisits)
    inflation = [w.bend.inflation for w in audit.windows]
    jumps = {step.laid.later for step in audit.jumps}
    return {
        "mqslam_version": __version__,
        "dataset": {
            **dataset,
            "sweeps": len(sweeps),
            "duration_s": float(sweeps.times[-1] - sweeps.times[0] + sweeps.revolution_s),
            "length_m": float(sweeps.travelled[-1]) if sweeps.track is not None else None,
            "points": len(sweeps.points),
        },
        "trajectory": trajectory,
        "verdict": {"status": audit.status, "reasons": audit.reasons},
        "not_judged": list_unjudged(audit) + list_uncovered(sweeps, WINDOW * sweeps.revolution_s),
        "threshold": TORN_INFLATION,
        "bend_m": settings.bend_m,
        "speeds": _summarise_speeds(audit),
        "windows": {
            "count": len(audit.windows),
            "undecided": len(audit.windows) - torn.total,
            "torn": torn.count,
            "torn_share_at_least": torn.lower_bound(CONFIDENCE),
            "torn_share_at_most": torn.upper_bound(CONFIDENCE),
            "inflation_median": float(np.median(inflation)) if inflation else None,
            "psi_per_point": _mean([w.bend.psi for w in audit.windows]),
            "matched": _mean([w.bend.matched for w in audit.windows]),
        },
        "revisits": {
            "count": len(audit.revisits),
            "sure": off.total,
            "torn": off.count,
            "torn_share_at_least": off.lower_bound(CONFIDENCE),
            "torn_share_at_most": off.upper_bound(CONFIDENCE),
            "median_m": float(np.median([r.revisit.distance_m for r in sure])) if sure else None,
            "worst_m": max((r.revisit.distance_m for r in sure if r.torn), default=None),
        }
        if sweeps.track is not None
        else None,
        **summarise_tests(audit, bounds),
        "extrinsics": None if extrinsics is None else list(extrinsics),
        "warnings": list(warnings),
        "per_window": [list_window(w) for w in audit.windows],
        "per_revisit": [list_revisit(r, sweeps) for r in audit.revisits],
        "per_step": [list_step(s, sweeps, jumps=s.laid.later in jumps) for s in audit.steps],
        "per_span": [list_span(s, sweeps) for s in audit.spans],
    }


def summarise_mended(mended: Mended, given: Mapping[str, Any], config: Config) -> dict[str, Any]:
    """Returns what audit.json says of the mended trajectory: how it was mended, and its own audit.

    Args:
        mended: the trajectory and its audit.
        given: content of audit.json on the trajectory as it was given.
        config: all settings.
    """
    judged = mended.result
    own = summarise(judged.audit, judged.sweeps, config.audit, config.verdict, given["dataset"], given["trajectory"])
    return {
        "sentence": describe_mended(mended, given),
        "rounds": mended.rounds,
        "ties": mended.ties,
        "loops": mended.loops,
        "moved_m": mended.moved_m,
        "stretch": mended.stretch,
        "worse": mended.is_worse,
        **{name: value for name, value in own.items() if name not in _OF_BOTH},
    }


def describe_mended(mended: Mended, given: Mapping[str, Any]) -> str:
    """Returns what mending has led to, as a sentence.

    Args:
        mended: the trajectory and its audit.
        given: content of audit.json on the trajectory as it was given.
    """
    before = given["verdict"]["status"]
    if not mended.rounds and before == VerdictStatus.NOT_JUDGED:
        return "The audit could not judge enough to mend anything: the trajectory is as it was given."
    if not mended.rounds:
        return "The audit found nothing to mend: the trajectory is as it was given."
    after = mended.result.audit.status
    if mended.is_worse:
        return (
            f"Mending failed: the mended trajectory is judged worse ({after}) than the given one ({before}). Keep that one."
        )
    held = f"{count_of(mended.ties, 'motion')} and {count_of(mended.loops, 'revisit')} by psi hold the mended trajectory"
    longer = ""
    if abs(mended.stretch - 1.0) > SCALE_WARN:
        longer = f" and makes the path {mended.stretch:.3f} times as long"
    return f"{held}, which moves poses by up to {mended.moved_m:.2f} m{longer}: the verdict was {before} and is {after}."


def _summarise_speeds(audit: Audit) -> dict[str, Any]:
    """Returns what the speeds show, and how far windows and speeds can tell a trajectory to be wrong."""
    sure = [w.speed for w in audit.windows if w.speed is not None and w.speed.sure]
    capture = audit.capture
    return {
        "sure": len(sure),
        "contradicted": sum(contradicts(speed, capture) for speed in sure),
        "error_median": float(np.median([speed.error_mps for speed in sure])) if sure else None,
        "capture_m": capture.window_m,
        "capture_mps": capture.speed_mps,
        "searched_mps": capture.searched_mps,
    }


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def summarise_tests(audit: Audit, bounds: VerdictConfig) -> dict[str, Any]:
    """Returns what each test of a map found, and the numbers of those besides windows and revisits, by name.

    Args:
        audit: the map, judged.
        bounds: settings of the verdict.
    """
    return {
        "steps": {
            "count": len(audit.steps),
            "judged": sum(step.judged for step in audit.steps),
            "jumps": len(audit.jumps),
            "median_m": float(np.median([s.laid.size_m for s in audit.steps])) if audit.steps else None,
        },
        "spans": {
            "count": len(audit.spans),
            "torn": sum(span.torn for span in audit.spans),
            "median_m": float(np.median([s.distance_m for s in audit.spans])) if audit.spans else None,
        },
        "sums": {"count": len(audit.sums), "torn": sum(one.torn for one in audit.sums)},
        "pooled": _list_pooled(audit.pooled),
        "tests": {name: _list_findings(findings) for name, findings in audit.tests.items()},
        "false_alarms": {"rate": bounds.false_alarms, "p_value_below": bounds.share_of_false_alarms},
    }


def _list_pooled(pooled: Pooled | None) -> dict[str, Any]:
    """Returns what a map asks for as a whole, by name; without anything but the number of spans where it is unknown."""
    if pooled is None:
        return {"spans": 0}
    values: dict[str, Any] = {"spans": pooled.spans}
    for axis, name in enumerate(("forward_per_m", "left_per_m", "yaw_per_m")):
        values |= {name: float(pooled.bias[axis]), f"{name}_sigma": float(pooled.sigma[axis])}
        values[f"{name}_p_value"] = float(pooled.p_value[axis])
    values |= {"late_s": pooled.delay.seconds, "late_s_sigma": pooled.delay.sigma, "late_s_p_value": pooled.delay.p_value}
    if pooled.lever is not None:
        values["turns"] = pooled.lever.turns
        for axis, name in enumerate(("ahead_m", "left_m")):
            values |= {name: float(pooled.lever.arm[axis]), f"{name}_sigma": float(pooled.lever.sigma[axis])}
            values[f"{name}_p_value"] = float(pooled.lever.p_value[axis])
    return values


def _list_findings(findings: Sequence[Finding]) -> dict[str, Any]:
    status, reasons = verdict_of(findings)
    p_value = find_smallest(f.p_value for f in findings if f.p_value is not None)
    judged = status if any(f.judged for f in findings) else VerdictStatus.NOT_JUDGED
    return {"status": judged, "p_value": p_value, "reasons": reasons}


def write_audit(folder: Path, config: Config, summary: Mapping[str, Any]) -> None:
    """Writes every result file of an audit but its pictures and its page into an existing folder.

    Args:
        folder: the folder.
        config: all settings.
        summary: content of audit.json.

    Raises:
        OutputError: a file cannot be written.
    """
    write_text(folder / "config.yaml", dump_yaml(config))
    write_text(folder / "audit.csv", _format_csv(summary["per_window"], WindowRow))
    write_text(folder / "revisits.csv", _format_csv(summary["per_revisit"], RevisitRow))
    write_text(folder / "steps.csv", _format_csv(summary["per_step"], StepRow))
    write_text(folder / "spans.csv", _format_csv(summary["per_span"], SpanRow))
    write_text(folder / "run.log", _format_log(summary))
    write_json(folder / "audit.json", summary)


def _format_log(summary: Mapping[str, Any]) -> str:
    """Returns the text of run.log."""
    dataset, trajectory = summary["dataset"], summary["trajectory"]
    under = "" if trajectory is None else f" under {trajectory}"
    title = f"mqslam {summary['mqslam_version']}: audit of {dataset['path']} ({dataset['format']}){under}"
    return format_log(title, [*(f"warning: {warning}" for warning in summary["warnings"]), *list_verdict(summary)])


def _format_csv(rows: Sequence[Mapping[str, Any]], columns: type) -> str:
    """Returns rows of numbers under the names of a typed dictionary. Where `torn` was not decided, it is `unknown`."""
    cells = [{key: _format_cell(key, value) for key, value in row.items()} for row in rows]
    return format_csv(cells, list(columns.__annotations__))


def _format_cell(key: str, value: Any) -> Any:
    if key == "torn" and value is None:
        return "unknown"
    return f"{value:.9g}" if isinstance(value, float) else value
