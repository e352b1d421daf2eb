"""The numbers and the verdict of a run, as `summary.json` holds them."""

from __future__ import annotations

import resource
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

import mqslam
from mqslam.audit.findings import judge_windows
from mqslam.audit.verdict import Finding, Share, VerdictStatus, verdict_of
from mqslam.core.measurement import Measurement, Status
from mqslam.core.recording import Recording
from mqslam.detection.stage import warn_of_unread
from mqslam.evaluation import evaluate
from mqslam.mapping.render import select_moving
from mqslam.solution import Run

_LISTED = 5  # gaps that are named one by one
PARKED_S = 10.0  # shorter stops are traffic


def summarise(run: Run, recording: Recording) -> dict[str, Any]:
    """The content of summary.json, but for the run's key and its warnings."""
    before, after = run.map_odometry, run.map_optimised
    torn = Share(sum(w.torn for w in run.checks), len(run.checks))
    confidence = run.config.verdict.confidence
    truth = recording.ground_truth
    found = None if truth is None else evaluate(run.optimised, truth)
    found_before = None if truth is None else evaluate(run.odometry, truth)
    status, reasons = verdict(run)
    return {
        "mqslam_version": mqslam.__version__,
        "frontend": run.frontend,
        "before": run.before,
        "doppler_beta": run.doppler_beta,
        "dataset": {
            "format": recording.format,
            "path": str(recording.path),
            "revolutions": len(recording),
            "unread": len(run.unread),
            "duration_s": recording.duration_s,
            "length_m": run.optimised.length_m,
        },
        "psi": {
            "odometry": float(before.psi.sum()),
            "optimised": float(after.psi.sum()),
            "per_point_odometry": before.psi_per_point,
            "per_point_optimised": after.psi_per_point,
            "matched_odometry": before.matched_share,
            "matched_optimised": after.matched_share,
        },
        "inflation": {
            "windows": torn.total,
            "torn": torn.count,
            "torn_share_at_least": torn.at_least(confidence),
            "torn_share_at_most": torn.at_most(confidence),
            "median": float(np.median([w.bend.inflation for w in run.checks])) if run.checks else None,
        },
        "verdict": {"status": status, "reasons": reasons},
        "factors": {
            "odometry": run.odometry_factors,
            "psi": len(run.measurements),
            "loop": len(run.loops),
            "loop_rejected": run.loops_rejected,
        },
        "evaluation": None if found is None else asdict(found),
        "evaluation_odometry": None if found_before is None else asdict(found_before),
        "runtime_s": {
            name: run.runtime_s.get(name, 0.0)
            for name in ("read", "detect", "windows", "loops", "optimise", "render", "check", "total")
        },
        "peak_rss_mb": peak_rss_mb(),
    }


def verdict(run: Run) -> tuple[VerdictStatus, list[str]]:
    """The verdict on a run's map, and why, from the run alone.

    Only windows show the map. Where there is none it is not judged, and what else there is to say is a reason.
    """
    settings, scans = run.config.verdict, len(run.optimised)
    windows = judge_windows(run.checks, scans, run.config.audit.window, settings)
    others = [*_judge_track(run), *_judge_optimisation(run)]
    if not run.checks:
        others = [replace(f, status=VerdictStatus.NOT_JUDGED) if f.status is VerdictStatus.WARN else f for f in others]
    return verdict_of([*windows, *others])


def _judge_track(run: Run) -> list[Finding]:
    """What the scans that were read and tracked say about the map."""
    settings, motions = run.config.verdict, run.measurements
    lost, degenerate = share(motions, Status.LOST), share(motions, Status.DEGENERATE)
    found = [Finding(VerdictStatus.PASS, "no scan lost track")]
    if lost.count:
        grave = lost.is_above(settings.lost_fail, settings)
        said = f"{lost.count} of {lost.total} scans lost track and follow the prediction"
        found = [Finding(VerdictStatus.FAIL if grave else VerdictStatus.WARN, said)]
    if run.unread:
        found.append(Finding(VerdictStatus.WARN, f"{len(run.unread)} of {len(run.optimised)} revolutions could not be read"))
    if degenerate.is_above(settings.degenerate_warn, settings):
        said = f"{degenerate.count} of {degenerate.total} scans do not observe every direction of motion"
        found.append(Finding(VerdictStatus.WARN, said))
    return found


def _judge_optimisation(run: Run) -> list[Finding]:
    """What optimisation made of the map; nothing where it had nothing to do."""
    if run.unoptimised is not None:
        said = f"the pose graph could not be optimised: the trajectory is {run.frontend}'s motions, chained"
        return [Finding(VerdictStatus.FAIL, said)]
    before, after = run.map_odometry.psi_per_point, run.map_optimised.psi_per_point
    if not (run.odometry_factors or run.loops) or not run.checks or before is None or after is None or before <= 0.0:
        return []
    ratio = after / before
    worse = VerdictStatus.FAIL if ratio > run.config.verdict.worse else VerdictStatus.PASS
    return [Finding(worse, f"psi per point is {ratio:.2f} times that of the map before optimisation")]


def share(motions: Sequence[Measurement], status: Status) -> Share:
    """How many of the motions have a status."""
    return Share(sum(m.status is status for m in motions), len(motions))


def peak_rss_mb() -> float:
    """Largest memory any process of this run has held [MB]."""
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    workers = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    return max(own, workers) / 1024.0


def run_warnings(run: Run, recording: Recording) -> list[str]:
    """What happened during a run that its reader should know first."""
    found = [*recording.faults, *warn_of_unread(run.unread), *run.warnings]
    found += _gaps(recording.gaps(), run.config.tracker.longest_coast_s)
    for status, what in ((Status.LOST, "lost track"), (Status.DEGENERATE, "did not observe every direction")):
        found += [f"{what} from {begin:.1f} s to {end:.1f} s" for begin, end in stretches(run.measurements, status)]
    found += [f"stood still from {begin:.1f} s to {end:.1f} s: rendered once" for begin, end in parked(run, recording)]
    return found


def _gaps(gaps: list[tuple[int, float]], longest_coast_s: float) -> list[str]:
    """Warnings of the first gaps, and what is missing in all where there are many."""
    found = [_gap(k, missing, longest_coast_s) for k, missing in gaps[:_LISTED]]
    if len(gaps) > _LISTED:
        missing_s = sum(missing for _, missing in gaps)
        found.append(f"{len(gaps) - _LISTED} more radar gaps; {missing_s:.2f} s are missing in all")
    return found


def _gap(scan: int, missing_s: float, longest_coast_s: float) -> str:
    """Returns the warning of a gap after a scan."""
    where = f"of {missing_s:.2f} s after scan {scan} (counted from 0)"
    if missing_s < longest_coast_s:
        return f"radar gap {where}"
    return f"jump of the clock or pause {where}: what lies beyond it is placed by a guess unless a loop ties it"


def parked(run: Run, recording: Recording) -> list[tuple[float, float]]:
    """Spans [s] of at least PARKED_S in which no revolution moved on, and the map holds only the first."""
    moved = recording.start_times[select_moving(run.optimised.poses, run.config.map)]
    ends = np.append(moved[1:], recording.duration_s)
    return [(float(a), float(b)) for a, b in zip(moved, ends, strict=True) if b - a >= PARKED_S]


def stretches(windows: list[Measurement], status: Status) -> list[tuple[float, float]]:
    """Spans [s] of successive windows that share a status."""
    spans: list[tuple[float, float]] = []
    for window in windows:
        if window.status is not status:
            continue
        if spans and spans[-1][1] == window.t0:
            spans[-1] = (spans[-1][0], window.t1)
        else:
            spans.append((window.t0, window.t1))
    return spans
