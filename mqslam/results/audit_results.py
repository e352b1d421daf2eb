"""Writes the results of an audit: its numbers as JSON, and the judgement of every window, revisit, step and span as CSV.

A step is the place between two successive scans; a jump is a torn step. A revisit is a place that the trajectory passes
twice: the later pass is registered on the earlier pass. A span is a stretch of path: its end is registered on its begin. A
sweep is a scan, or one turn of the sensor in a point cloud. A window, step, revisit or span is torn if it is off by more
than chance explains and by more than is tolerated. Inflation is the squared size of a correction in units of its covariance.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.judge import Audit
from mqslam.auditing.mending.rounds import Mended
from mqslam.auditing.registration import SPEED_ERROR_MPS
from mqslam.auditing.revisits import share_torn_revisits
from mqslam.auditing.sizes import TORN_INFLATION, WINDOW
from mqslam.auditing.spans.pooled import Pooled
from mqslam.auditing.spans.robust import Estimate
from mqslam.auditing.speeds import contradicts
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.table import SCALE_WARN, apply_tolerance, share_of_false_alarms
from mqslam.auditing.verdict import Finding, Share, VerdictStatus, verdict_of
from mqslam.auditing.windows.windows import Undecided, share_torn
from mqslam.config import Config, VerdictConfig, dump_yaml
from mqslam.core.statistics import find_smallest
from mqslam.core.wording import count_of, describe_times
from mqslam.execution.files import write_json, write_text
from mqslam.results.audit_gate import name_audited, write_gate
from mqslam.results.files import format_csv, format_log, format_numbers, list_notes, list_verdict
from mqslam.version import __version__

# entries that audit.json holds only once, since they are the same for the given and for the mended trajectory
_OF_BOTH: Final = ("mqslam_version", "dataset", "trajectory", "threshold", "bend_m", "extrinsics", "warnings", "baseline")
_READ: Final = ("verdict", "tests", "not_judged", "notes", "warnings", "baseline")  # entries that people read as text
_POSE, _OFFSET = ("x", "y", "yaw"), ("dx", "dy", "dyaw")  # metres, metres, radians
_SIGMAS, _STATED = ("sigma_x", "sigma_y", "sigma_yaw"), ("claimed_sigma_x", "claimed_sigma_y", "claimed_sigma_yaw")

Columns: TypeAlias = dict[str | tuple[str, ...], Callable[[Any, Sweeps], Any]]
"""Columns of a CSV file in order: by the name of a column, or the names of several, the function that makes their cells.

The function takes a window, revisit, step or span, and the sweeps. Lengths are in metres, angles in radians, times in
seconds since the recording began.
"""

_WINDOW: Final[Columns] = {
    "t0": lambda w, _: w.t0,
    "t1": lambda w, _: w.t1,
    _POSE: lambda w, _: w.pose,
    "torn": lambda w, _: w.torn if w.undecided is None else None,
    "by_speed": lambda w, _: w.by_speed,
    "undecided": lambda w, _: w.undecided,
    "inflation": lambda w, _: w.bend.inflation,
    "p_value": lambda w, _: _known(w.p_value),
    _OFFSET: lambda w, _: w.bend.correction,
    _SIGMAS: lambda w, _: _sigmas(w.bend.covariance),
    ("dv", "domega"): lambda w, _: w.bend.correction[[0, 2]] / (w.t1 - w.t0),
    "size_m": lambda w, _: w.bend.size_m,
    "psi_per_point": lambda w, _: w.bend.psi,
    "psi_per_point_best": lambda w, _: w.bend.psi_best,
    "matched": lambda w, _: w.bend.matched,
    "matched_best": lambda w, _: w.bend.matched_best,
    "points": lambda w, _: w.bend.points,
    "speed_error": lambda w, _: w.speed.error_mps if w.speed is not None and w.speed.sure else None,
    "map_entropy": lambda w, _: w.measures.map_entropy,
    "plane_variance": lambda w, _: w.measures.plane_variance,
    "joint_entropy": lambda w, _: w.measures.joint_entropy,
    "grid_entropy": lambda w, _: w.measures.grid_entropy,
}
_REVISIT: Final[Columns] = {
    ("t_earlier", "t_later"): lambda r, sweeps: sweeps.times[[r.registration.earlier, r.registration.later]],
    _POSE: lambda r, sweeps: sweeps.poses[r.registration.later],
    "torn": lambda r, _: r.torn if r.sure else None,
    "sure": lambda r, _: r.sure,
    _OFFSET: lambda r, _: r.offset,
    _SIGMAS: lambda r, _: _sigmas(r.covariance),
    _STATED: lambda r, _: (None,) * 3 if r.stated_covariance is None else _sigmas(r.stated_covariance),
    "inflation": lambda r, _: r.inflation,
    "p_value": lambda r, _: _known(r.p_value),
    "matched": lambda r, _: r.registration.matched,
    "psi_per_point": lambda r, _: r.registration.psi,
    "psi_per_point_best": lambda r, _: r.registration.psi_best,
}
_SPAN: Final[Columns] = {  # the offsets do not contain the corrections of the whole map
    "t_earlier": lambda s, _: s.t0,
    "t_later": lambda s, _: s.t1,
    _POSE: lambda s, sweeps: sweeps.poses[s.registration.later],
    "path_m": lambda s, _: s.registration.path_m,
    _OFFSET: lambda s, _: s.offset,
    "matched": lambda s, _: s.registration.matched,
    "p_value": lambda s, _: _known(s.p_value),
    "torn": lambda s, _: s.torn if np.isfinite(s.p_value) else None,
}


def _make_step_columns(jumps: Collection[int] = ()) -> Columns:
    """Returns the columns of steps; a step is a jump if its later sweep is in `jumps`."""
    return {
        "t": lambda s, _: s.t,
        _POSE: lambda s, sweeps: sweeps.poses[s.registration.later],
        _OFFSET: lambda s, _: s.registration.offset,
        "size_m": lambda s, _: s.registration.size_m,
        "matched": lambda s, _: s.registration.matched,
        "p_value": lambda s, _: _known(s.p_value),
        "torn": lambda s, _: s.registration.later in jumps if s.judged else None,
    }


_FILES: Final = {
    "audit.csv": ("per_window", _WINDOW),
    "revisits.csv": ("per_revisit", _REVISIT),
    "steps.csv": ("per_step", _make_step_columns()),
    "spans.csv": ("per_span", _SPAN),
}


def _sigmas(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.sqrt(np.diag(covariance))


def _known(p_value: float) -> float | None:
    """Returns a p-value, or None if it is NaN because nothing was judged."""
    return p_value if np.isfinite(p_value) else None


def _names(columns: Columns) -> list[str]:
    return list(chain.from_iterable([names] if isinstance(names, str) else names for names in columns))


def _list_rows(items: Sequence[Any], columns: Columns, sweeps: Sweeps) -> list[dict[str, Any]]:
    """Returns one row for each of `items`, which are windows, revisits, steps or spans; a row maps columns to values."""
    names = _names(columns)
    rows = []
    for item in items:
        parts = ((name, find(item, sweeps)) for name, find in columns.items())
        cells = chain.from_iterable([part] if isinstance(name, str) else part for name, part in parts)
        numbers = (cell.item() if isinstance(cell, np.generic) else cell for cell in cells)
        rows.append(dict(zip(names, numbers, strict=True)))
    return rows


def summarise(
    audit: Audit,
    sweeps: Sweeps,
    config: Config,
    dataset: Mapping[str, Any],
    trajectory: str | None,
    warnings: Sequence[str] = (),
    extrinsics: tuple[float, float, float] | None = None,
    *,
    is_part: bool = False,
) -> dict[str, Any]:
    """Returns the content of audit.json: verdict, numbers of each test, and rows per window, revisit, step and span.

    Args:
        audit: judgement of the map.
        sweeps: the points that were judged, with their times.
        config: all settings.
        dataset: format and path of the audited data.
        trajectory: source of the trajectory; None for a point cloud without a trajectory.
        warnings: warnings that a reader must know before the numbers.
        extrinsics: x, y [m], yaw [degrees] of the sensor in the frame whose trajectory was given; None if none were stated.
        is_part: whether only a part of a recording was audited, so that poses outside of it are left out on purpose.
    """
    torn, off = share_torn(audit.windows), share_torn_revisits(audit.revisits)
    sure = [r for r in audit.revisits if r.sure]
    revisits = {
        "count": len(audit.revisits),
        "sure": off.total,
        **share_to_numbers(off),
        "median_m": _median([r.distance_m for r in sure]),
        "worst_m": max((r.distance_m for r in sure if r.torn), default=None),
    }
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
        "verdict": audit.verdict._asdict(),
        "not_judged": list_unjudged(audit) + _list_uncovered(sweeps, is_part=is_part),
        "threshold": TORN_INFLATION,
        "bend_m": apply_tolerance(config.audit, config.verdict).bend_m,
        "speeds": _summarise_speeds(audit),
        "windows": {
            "count": len(audit.windows),
            "undecided": len(audit.windows) - torn.total,
            **share_to_numbers(torn),
            "inflation_median": _median([w.bend.inflation for w in audit.windows]),
            "psi_per_point": _mean([w.bend.psi for w in audit.windows]),
            "matched": _mean([w.bend.matched for w in audit.windows]),
        },
        "revisits": revisits if sweeps.track is not None else None,
        **summarise_audit(audit),
        **summarise_tests(audit.tests, config.verdict),
        "extrinsics": None if extrinsics is None else list(extrinsics),
        "baseline": None,
        "warnings": list(warnings),
        "per_window": _list_rows(audit.windows, _WINDOW, sweeps),
        "per_revisit": _list_rows(audit.revisits, _REVISIT, sweeps),
        "per_step": _list_rows(audit.steps, _make_step_columns({step.registration.later for step in audit.jumps}), sweeps),
        "per_span": _list_rows(audit.spans, _SPAN, sweeps),
    }


def share_to_numbers(torn: Share) -> dict[str, Any]:
    """Returns entries of audit.json: the number of torn windows or revisits, and confidence bounds of their share."""
    bounds = {"torn_share_at_least": torn.lower_bound(), "torn_share_at_most": torn.upper_bound()}
    return {"torn": torn.count, **bounds}


def summarise_mended(mended: Mended, given: Mapping[str, Any], config: Config, *, is_part: bool = False) -> dict[str, Any]:
    """Returns the entry `mended` of audit.json: how the trajectory was mended, and the audit of the mended trajectory.

    Entries that are the same for both trajectories (`_OF_BOTH`) are left out.

    Args:
        mended: the mended trajectory and its audit.
        given: content of audit.json on the given trajectory.
        config: all settings.
        is_part: whether only a part of the recording was audited.
    """
    judged = mended.result
    own = summarise(judged.audit, judged.sweeps, config, given["dataset"], given["trajectory"], is_part=is_part)
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
    """Returns the result of mending in one or two sentences.

    Args:
        mended: the mended trajectory and its audit.
        given: content of audit.json on the given trajectory.
    """
    before = given["verdict"]["status"]
    if not mended.rounds and before == VerdictStatus.NOT_JUDGED:
        return "The audit could judge too little to mend anything, so the trajectory was left unchanged."
    if not mended.rounds:
        return "The audit found nothing to mend, so the trajectory was left unchanged."
    after = mended.result.audit.verdict.status
    if mended.is_worse:
        return (
            f"Mending failed: the mended trajectory is judged worse ({after}) than the given one ({before}). "
            "Keep the given one."
        )
    used = f"{count_of(mended.ties, 'motion')} and {count_of(mended.loops, 'revisit')} measured by psi"
    longer = ""
    if abs(mended.stretch - 1.0) > SCALE_WARN:
        longer = f" and makes the path {mended.stretch:.3f} times as long"
    moved = f"The trajectory was mended with {used}, which moves poses by up to {mended.moved_m:.2f} m{longer}"
    return f"{moved}: the verdict was {before} and is now {after}."


def list_unjudged(audit: Audit) -> list[str]:
    """Returns a line for each finding of a test that could not judge, and for each reason why windows are undecided.

    Args:
        audit: judgement of the map.
    """
    blind = [finding.reason for finding in chain.from_iterable(audit.tests.values()) if not finding.judged]
    undecided = Counter(window.undecided for window in audit.windows if window.undecided is not None)
    windows = count_of(len(audit.windows), "window")
    return blind + [
        f"{count} of {windows}: {reason}{'' if reason is Undecided.SPARSE else ', so that any error there could hide'}"
        for reason, count in undecided.items()
    ]


def _list_uncovered(sweeps: Sweeps, *, is_part: bool) -> list[str]:
    """Returns a line on scans without poses, and one on times with poses but without points.

    Scans or times that last no longer than a window are not listed. If `is_part`, poses outside the part of the recording
    are not listed either, since they are left out on purpose. Without a trajectory, there are no lines.
    """
    track, span_s = sweeps.track, WINDOW * sweeps.revolution_s
    if track is None:
        return []
    begin, end = float(track.times[0]), float(track.times[-1])
    first, last = float(sweeps.times[0]), float(sweeps.times[-1] + sweeps.revolution_s)
    missing = []
    if track.uncovered * sweeps.revolution_s > span_s:
        scans = f"{track.uncovered} of {count_of(track.scans, 'scan')}"
        missing.append(f"{scans}: the trajectory has poses {describe_times(begin, end)} only")
    parts = [describe_times(a, b) for a, b in ((begin, first), (last, end)) if b - a > span_s]
    if parts and not is_part:
        missing.append(f"poses {' and '.join(parts)}: the data hold no points from that time")
    return missing


def _summarise_speeds(audit: Audit) -> dict[str, Any]:
    """Returns the entry `speeds` of audit.json: the results of the speed checks, and the errors that windows can measure."""
    sure = [w.speed for w in audit.windows if w.speed is not None and w.speed.sure]
    capture = audit.capture
    return {
        "sure": len(sure),
        "contradicted": sum(contradicts(speed, capture) for speed in sure),
        "error_median": _median([speed.error_mps for speed in sure]),
        "capture_m": capture.window_m,
        "capture_mps": capture.speed_mps,
        "searched_mps": SPEED_ERROR_MPS,
    }


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


def summarise_audit(audit: Audit) -> dict[str, Any]:
    """Returns entries of audit.json on steps, spans, sums of spans, errors of the whole trajectory, and final psi.

    Final psi is psi divided by the lowest psi that the same returns can have: (1) over all decided windows, (2) across
    passes, over all sure revisits. Each is None without such a window or revisit.
    """
    return {
        "final_psi": {
            "over_best_of_windows": audit.compute_psi_over_best(),
            "over_best_of_passes": audit.compute_psi_over_best_of_passes(),
        },
        "steps": {
            "count": len(audit.steps),
            "judged": sum(step.judged for step in audit.steps),
            "jumps": len(audit.jumps),
            "median_m": _median([s.registration.size_m for s in audit.steps]),
        },
        "spans": {
            "count": len(audit.spans),
            "torn": sum(span.torn for span in audit.spans),
            "median_m": _median([s.distance_m for s in audit.spans]),
        },
        "sums": {"count": len(audit.sums), "torn": sum(one.torn for one in audit.sums)},
        "pooled": _summarise_pooled(audit.pooled),
    }


def summarise_tests(tests: Mapping[str, Sequence[Finding]], bounds: VerdictConfig) -> dict[str, Any]:
    """Returns two entries of audit.json: the findings of each test, and the p-value below which a test may call a map bad.

    Args:
        tests: findings of each test, by the test's name.
        bounds: settings of the verdict.
    """
    return {
        "tests": {name: _summarise_findings(findings) for name, findings in tests.items()},
        "false_alarms": {"rate": bounds.false_alarms, "p_value_below": share_of_false_alarms(bounds)},
    }


def _summarise_pooled(pooled: Pooled | None) -> dict[str, Any]:
    """Returns the entry `pooled` of audit.json: errors of the whole trajectory that all spans show together.

    If the spans are too few for that (`pooled` is None), the entry only states that 0 spans were used.
    """
    if pooled is None:
        return {"spans": 0}
    values: dict[str, Any] = {"spans": pooled.spans}
    values |= _name_axes(("forward_per_m", "left_per_m", "yaw_per_m"), pooled.bias) | _name_axes(("late_s",), pooled.delay)
    if pooled.lever is not None:
        values["turns"] = pooled.turns
        values |= _name_axes(("ahead_m", "left_m"), pooled.lever)
    return values


def _name_axes(names: Sequence[str], estimate: Estimate) -> dict[str, float]:
    """Returns by name the values, standard deviations and p-values of an estimate for N axes.

    The axis `left_m` has the three names `left_m`, `left_m_sigma` and `left_m_p_value`.
    """
    endings = ("", "_sigma", "_p_value")
    return {
        f"{name}{ending}": float(part[axis])
        for axis, name in enumerate(names)
        for ending, part in zip(endings, estimate, strict=True)
    }


def _summarise_findings(findings: Sequence[Finding]) -> dict[str, Any]:
    status, _, reasons = verdict_of({"": findings})
    p_value = find_smallest(f.p_value for f in findings if f.p_value is not None)
    judged = status if any(f.judged for f in findings) else VerdictStatus.NOT_JUDGED
    return {"status": judged, "p_value": p_value, "reasons": reasons}


def write_audit(folder: Path, config: Config, summary: Mapping[str, Any], word: Callable[[str], str] = str) -> None:
    """Writes every result file of an audit into an existing folder, except the page with its files, and mended.tum.

    Args:
        folder: the folder.
        config: all settings.
        summary: content of audit.json.
        word: returns a text with its remedies in the words of the caller; it is applied to run.log, audit.md and junit.xml.

    Raises:
        OutputError: a file cannot be written.
    """
    write_text(folder / "config.yaml", dump_yaml(config))
    for name, (key, columns) in _FILES.items():
        write_text(folder / name, format_csv(map(format_numbers, summary[key]), _names(columns)))
    title = f"mqslam {summary['mqslam_version']}: audit of {name_audited(summary)}"
    worded = {key: _word_texts(value, word) if key in _READ else value for key, value in summary.items()}
    lines = [*list_notes(worded, worded.get("notes", ())), *list_verdict(worded)]
    write_text(folder / "run.log", format_log(title, lines))
    write_gate(folder, worded)
    write_json(folder / "audit.json", summary)


def _word_texts(value: Any, word: Callable[[str], str]) -> Any:
    """Returns a part of a summary with the function `word` applied to each text; a status stays as it is."""
    if isinstance(value, Mapping):
        return {key: _word_texts(one, word) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_word_texts(one, word) for one in value]
    return word(value) if type(value) is str else value
