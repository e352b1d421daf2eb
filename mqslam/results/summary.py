"""The numbers and the verdict of a run, as `summary.json` holds them."""

from __future__ import annotations

import resource
from dataclasses import asdict
from typing import Any

import numpy as np

import mqslam
from mqslam.audit.judge import FAIL_WINDOWS, WARN_WINDOWS
from mqslam.core.measurement import Measurement, Status
from mqslam.core.motion import LONGEST_COAST_S
from mqslam.core.recording import Recording
from mqslam.detection.stage import unread_warnings
from mqslam.evaluation import evaluate
from mqslam.mapping.render import moving
from mqslam.slam import Run

# shares of windows, chosen so that a run a user would look into is not called `pass`
WARN_LOST, FAIL_LOST = 0.0, 0.2
WARN_DEGENERATE = 0.1
FAIL_MATCHED = 0.15  # below this share of matched points nothing overlaps and psi means nothing
PARKED_S = 10.0  # shorter stops are traffic
WORSE = 1.1  # psi per point after over before; passes that loops lay on each other cost a little more than alone


def summarise(run: Run, recording: Recording) -> dict[str, Any]:
    """The content of summary.json."""
    before, after = run.map_odometry, run.map_optimised
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
            "windows": len(run.checks),
            "torn": sum(w.torn for w in run.checks),
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


def verdict(run: Run) -> tuple[str, list[str]]:
    """`pass`, `warn` or `fail`, and why, from the run alone."""
    failures, warnings = [], []
    windows = run.measurements
    lost, degenerate = share(windows, Status.LOST), share(windows, Status.DEGENERATE)
    if lost > FAIL_LOST:
        failures.append(f"{lost:.0%} of the windows lost track")
    elif lost > WARN_LOST:
        warnings.append(f"{lost:.1%} of the windows lost track and follow the prediction")
    if run.unread:
        warnings.append(f"{len(run.unread)} of {len(windows) + 1} revolutions could not be read")
    if degenerate > WARN_DEGENERATE:
        warnings.append(f"{degenerate:.0%} of the windows do not observe every direction of motion")
    overlap = run.map_optimised.matched_share
    if overlap < FAIL_MATCHED:
        failures.append(f"only {overlap:.0%} of the map's points are seen twice: psi cannot judge it")
    torn = sum(w.torn for w in run.checks)
    if torn > WARN_WINDOWS * len(run.checks):
        said = f"{torn} of {len(run.checks)} windows of the map are torn"
        (failures if torn > FAIL_WINDOWS * len(run.checks) else warnings).append(said)
    ratio = run.map_optimised.psi_per_point / run.map_odometry.psi_per_point
    if ratio > WORSE:
        failures.append(f"psi per point is {ratio:.2f} times that of the map before optimisation")
    if not run.odometry_factors and not run.loops and not failures and not warnings:
        return "pass", [f"no window was lost, {torn} of {len(run.checks)} windows of the map are torn"]
    if failures:
        return "fail", failures + warnings
    return ("warn", warnings) if warnings else ("pass", [f"psi per point is {ratio:.2f} times that before optimisation"])


def share(windows: list[Measurement], status: Status) -> float:
    """Part of the windows that have a status."""
    return float(np.mean([w.status is status for w in windows])) if windows else 0.0


def peak_rss_mb() -> float:
    """Largest memory any process of this run has held [MB]."""
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    workers = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    return max(own, workers) / 1024.0


def run_warnings(run: Run, recording: Recording) -> list[str]:
    """What happened during a run that its reader should know first."""
    found = [*recording.faults, *unread_warnings(run.unread)]
    found += [_gap(k, missing) for k, missing in recording.gaps()]
    for status, what in ((Status.LOST, "lost track"), (Status.DEGENERATE, "did not observe every direction")):
        found += [f"{what} from {begin:.1f} s to {end:.1f} s" for begin, end in stretches(run.measurements, status)]
    found += [f"stood still from {begin:.1f} s to {end:.1f} s: rendered once" for begin, end in parked(run, recording)]
    return found


def _gap(revolution: int, missing_s: float) -> str:
    """A warning of a gap after a revolution."""
    where = f"of {missing_s:.2f} s after revolution {revolution}"
    if missing_s < LONGEST_COAST_S:
        return f"radar gap {where}"
    return f"jump of the clock or pause {where}: what lies beyond it is placed by a guess unless a loop ties it"


def parked(run: Run, recording: Recording) -> list[tuple[float, float]]:
    """Spans [s] of at least PARKED_S in which no revolution moved on, and the map holds only the first."""
    moved = recording.start_times[moving(run.optimised.poses, run.config.map.travel_m, run.config.map.travel_rad)]
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
