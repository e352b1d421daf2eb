"""An audit: every window and every revisit of a map judged, and what that makes of the whole."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from mqslam.audit.inflation import Bend, bend
from mqslam.audit.measures import Measures, measures, sensors_of
from mqslam.audit.revisits import Revisit, revisit, revisit_pairs
from mqslam.audit.sweeps import Sweeps
from mqslam.audit.verdict import Finding, Share, VerdictStatus, verdict_of
from mqslam.config import AuditConfig, EstimatorConfig, LoopConfig, VerdictConfig
from mqslam.core import se2
from mqslam.execution.engine import Engine
from mqslam.execution.progress import Progress

_MOST = 0.5  # with a fault in a larger share of its windows, a map has it as a whole


@dataclass(frozen=True, slots=True)
class WindowAudit:
    """One window judged.

    Args:
        begin, end: its sweeps, begin <= k < end.
        t0, t1: when it begins and ends [s] since the recording's start.
        pose: (3,) of the sensor at its middle, world frame.
        bend: what would mend it.
        measures: the field's measures of the same points.
        torn: whether it is bent beyond what its covariance explains and beyond the settings' tolerance, or its sweeps do not
            overlap even at its best.
    """

    begin: int
    end: int
    t0: float
    t1: float
    pose: se2.Array
    bend: Bend
    measures: Measures
    torn: bool


@dataclass(frozen=True, slots=True)
class RevisitAudit:
    """One revisit judged.

    Args:
        revisit: the two passes and their offset.
        torn: whether they are off each other beyond what the covariance explains and beyond the settings' tolerance.
    """

    revisit: Revisit
    torn: bool


@dataclass(frozen=True)
class Audit:
    """A map judged.

    Args:
        windows: its windows in the order of time.
        revisits: places the trajectory comes back to.
        status: the verdict.
        reasons: why.
    """

    windows: list[WindowAudit]
    revisits: list[RevisitAudit]
    status: VerdictStatus
    reasons: list[str]


def audit(
    sweeps: Sweeps,
    settings: AuditConfig,
    estimator: EstimatorConfig,
    loops: LoopConfig,
    bounds: VerdictConfig,
    engine: Engine,
    progress: Progress,
) -> Audit:
    """Judge a map.

    Args:
        sweeps: its points under the trajectory.
        settings: of the audit.
        estimator: settings of the score.
        loops: settings of loops, whose floor holds for revisits too.
        bounds: settings of the verdict.
        engine: where windows and revisits are judged; the result does not depend on it.
        progress: called as windows and revisits are done.
    """
    windows = audit_windows(sweeps, settings, estimator, engine, progress)
    pairs = revisit_pairs(sweeps, settings)

    def done(number: int, found: Revisit | None) -> None:
        progress("revisits", number, len(pairs))

    laid = engine.map(_revisit, (sweeps, settings, estimator, loops), pairs, done)
    revisits = [RevisitAudit(found, torn_revisit(found, settings)) for found in laid if found is not None]
    return Audit(windows, revisits, *verdict(windows, revisits, len(sweeps), settings.window, bounds))


def audit_windows(
    sweeps: Sweeps, settings: AuditConfig, estimator: EstimatorConfig, engine: Engine, progress: Progress
) -> list[WindowAudit]:
    """Judge the windows of a map, in the order of time; those without a point, such as of scans in fog, are left out."""
    size = settings.window
    begins = list(range(0, len(sweeps) - size + 1, size))
    if begins and begins[-1] + size < len(sweeps):
        begins.append(len(sweeps) - size)  # the last one overlaps the one before, so that every sweep is judged
    begins = [begin for begin in begins if sweeps.begins[begin + size] > sweeps.begins[begin]]

    def done(number: int, window: WindowAudit) -> None:
        progress("audit", number, len(begins))

    return engine.map(_window, (sweeps, settings, estimator), begins, done)


def _window(shared: tuple[Sweeps, AuditConfig, EstimatorConfig], begin: int) -> WindowAudit:
    sweeps, settings, estimator = shared
    return audit_window(sweeps, begin, begin + settings.window, settings, estimator)


def audit_window(sweeps: Sweeps, begin: int, end: int, settings: AuditConfig, estimator: EstimatorConfig) -> WindowAudit:
    """Judge one window: the sweeps begin <= k < end."""
    span = sweeps.span(begin, end)
    turns = sweeps.turns[span]
    found = bend(sweeps, begin, end, estimator)
    beside = measures(
        sweeps.points[span],
        np.searchsorted(sweeps.numbers[begin:end], turns, side="right"),
        sensors_of(turns, sweeps.numbers, sweeps.poses),
        settings.radius_m,
        settings.cell_m,
    )
    bent = found.inflation > torn_threshold(settings) and found.size_m > settings.bend_m
    torn = bool(bent or found.matched_best < settings.overlap)
    t1 = sweeps.times[end - 1] + sweeps.revolution_s
    return WindowAudit(
        begin, end, float(sweeps.times[begin]), float(t1), sweeps.poses[(begin + end) // 2], found, beside, torn
    )


def _revisit(shared: tuple[Sweeps, AuditConfig, EstimatorConfig, LoopConfig], pair: tuple[int, int]) -> Revisit | None:
    sweeps, settings, estimator, loops = shared
    return revisit(sweeps, *pair, settings, estimator, loops)


def torn_threshold(settings: AuditConfig) -> float:
    """Inflation beyond which a window or a revisit is bent by more than chance, with three degrees of freedom."""
    return float(chi2.ppf(settings.probability, 3))


def torn_revisit(found: Revisit, settings: AuditConfig) -> bool:
    """Whether two passes are off each other."""
    beyond = found.inflation > torn_threshold(settings)
    far = found.distance_m > settings.torn_m or abs(found.offset[2]) > settings.torn_rad
    return bool(found.sure and beyond and far)


def verdict(
    windows: Sequence[WindowAudit], revisits: Sequence[RevisitAudit], scans: int, size: int, settings: VerdictConfig
) -> tuple[VerdictStatus, list[str]]:
    """The verdict on a map, and why.

    Args:
        windows: all that were judged.
        revisits: likewise.
        scans: number of sweeps of the map.
        size: number of sweeps of a window.
        settings: bounds, and the evidence that a verdict takes.
    """
    findings = judge_windows(windows, scans, size, settings)
    return verdict_of([*findings, judge_revisits(revisits, settings)])


def judge_windows(windows: Sequence[WindowAudit], scans: int, size: int, settings: VerdictConfig) -> list[Finding]:
    """What the windows of a map say about it, in a run as in an audit.

    Args:
        windows: those that were checked.
        scans: number of scans of the map.
        size: number of scans of a window.
        settings: bounds, and the evidence that a verdict takes.
    """
    if not windows:
        said = f"no window of {size} scans could be checked, so that nothing shows how good the map is"
        if scans < size:
            said = f"{_number(scans, 'scan')} {_are(scans)} too few to judge a map by: a window takes {size}"
        return [Finding(VerdictStatus.NOT_JUDGED, said)]
    torn = Share(sum(w.torn for w in windows), len(windows))
    status = torn.judge(settings.windows_warn, settings.windows_fail, settings)
    said = f"{torn.count} of {torn.total} windows {_are(torn.count)} torn"
    if status is VerdictStatus.NOT_JUDGED:
        said += f", too few to judge the map by: the share of torn ones may be {torn.range_text(settings)}"
    found = [Finding(status, said)]
    apart = Share(sum(w.bend.matched < settings.matched for w in windows), len(windows))
    if apart.is_above(_MOST, settings):
        matched = float(np.median([w.bend.matched for w in windows]))
        found.append(Finding(VerdictStatus.FAIL, f"only {matched:.0%} of the points are seen twice: nothing overlaps"))
    return found


def judge_revisits(revisits: Sequence[RevisitAudit], settings: VerdictConfig) -> Finding:
    """What the revisits of a map say about it. A map need not have any to pass: many a drive comes back to no place."""
    sure = [r for r in revisits if r.revisit.sure]
    if not sure:
        return Finding(VerdictStatus.PASS, _unjudged(revisits))
    off = [r for r in sure if r.torn]
    said = f"{len(off)} of {len(sure)} revisits {_are(len(off))} torn"
    if not off:
        return Finding(VerdictStatus.PASS, said)
    said += f", by up to {max(r.revisit.distance_m for r in off):.2f} m"
    torn = Share(len(off), len(sure))
    status = torn.judge(settings.revisits_warn, settings.revisits_fail, settings)
    row = any(a.torn and b.torn for a, b in itertools.pairwise(sure))  # one alone may be a place that looks like another
    if row and status is not VerdictStatus.FAIL:
        status = VerdictStatus.WARN
    if status is VerdictStatus.NOT_JUDGED:
        said += f", too few to judge drift by: the share of torn ones may be {torn.range_text(settings)}"
    return Finding(status, said)


def _unjudged(revisits: Sequence[RevisitAudit]) -> str:
    """Why no revisit shows the map's drift."""
    if revisits:
        return f"none of {_number(len(revisits), 'revisit')} is sure enough to show its drift"
    return "it comes back to no place that would show its drift"


def _number(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _are(count: int) -> str:
    return "is" if count == 1 else "are"
