"""An audit: every window and every revisit of a map judged, and what that makes of the whole."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from mqslam import se2
from mqslam.audit.inflation import Bend, bend
from mqslam.audit.measures import Measures, measures, sensors_of
from mqslam.audit.revisits import Revisit, revisit, revisit_pairs
from mqslam.audit.settings import AuditConfig
from mqslam.audit.sweeps import Sweeps
from mqslam.config import Config
from mqslam.detection import Progress
from mqslam.engine import Engine

WARN_WINDOWS, FAIL_WINDOWS = 0.05, 0.2  # shares of windows that are torn
WARN_REVISITS, FAIL_REVISITS = 0.02, 0.1  # shares of revisits that are torn
LEAST_MATCHED = 0.15  # below this share of matched points nothing overlaps and psi means nothing


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
        status: `pass`, `warn` or `fail`.
        reasons: why.
    """

    windows: list[WindowAudit]
    revisits: list[RevisitAudit]
    status: str
    reasons: list[str]


def audit(sweeps: Sweeps, config: Config, engine: Engine, progress: Progress) -> Audit:
    """Judge a map.

    Args:
        sweeps: its points under the trajectory.
        config: all settings.
        engine: where windows and revisits are judged; the result does not depend on it.
        progress: called as windows and revisits are done.
    """
    windows = audit_windows(sweeps, config, engine, progress)
    pairs = revisit_pairs(sweeps, config.audit)

    def done(number: int, found: Revisit | None) -> None:
        progress("revisits", number, len(pairs))

    laid = engine.map(_revisit, (sweeps, config), pairs, done)
    revisits = [RevisitAudit(found, torn_revisit(found, config.audit)) for found in laid if found is not None]
    return Audit(windows, revisits, *verdict(windows, revisits))


def audit_windows(sweeps: Sweeps, config: Config, engine: Engine, progress: Progress) -> list[WindowAudit]:
    """Judge the windows of a map that hold points, in the order of time."""
    size = config.audit.window
    begins = list(range(0, len(sweeps) - size + 1, size))
    if begins and begins[-1] + size < len(sweeps):
        begins.append(len(sweeps) - size)  # the last one overlaps the one before, so that every sweep is judged
    begins = [begin for begin in begins if sweeps.begins[begin] < sweeps.begins[begin + size]]

    def done(number: int, window: WindowAudit) -> None:
        progress("audit", number, len(begins))

    return engine.map(_window, (sweeps, config), begins, done)


def _window(shared: tuple[Sweeps, Config], begin: int) -> WindowAudit:
    sweeps, config = shared
    return audit_window(sweeps, begin, begin + config.audit.window, config)


def audit_window(sweeps: Sweeps, begin: int, end: int, config: Config) -> WindowAudit:
    """Judge one window: the sweeps begin <= k < end."""
    settings = config.audit
    span = sweeps.span(begin, end)
    turns = sweeps.turns[span]
    found = bend(sweeps, begin, end, config)
    beside = measures(
        sweeps.points[span],
        np.searchsorted(sweeps.numbers[begin:end], turns, side="right"),
        sensors_of(turns, sweeps.numbers, sweeps.poses),
        settings.radius_m,
        settings.cell_m,
    )
    bent = found.inflation > settings.threshold and found.size_m > settings.bend_m
    torn = bool(bent or found.matched_best < settings.overlap)
    t1 = sweeps.times[end - 1] + sweeps.period_s
    return WindowAudit(
        begin, end, float(sweeps.times[begin]), float(t1), sweeps.poses[(begin + end) // 2], found, beside, torn
    )


def _revisit(shared: tuple[Sweeps, Config], pair: tuple[int, int]) -> Revisit | None:
    sweeps, config = shared
    return revisit(sweeps, *pair, config)


def torn_revisit(found: Revisit, settings: AuditConfig) -> bool:
    """Whether two passes are off each other."""
    beyond = found.inflation > settings.threshold
    far = found.distance_m > settings.torn_m or abs(found.offset[2]) > settings.torn_rad
    return bool(found.sure and beyond and far)


def verdict(windows: list[WindowAudit], revisits: list[RevisitAudit]) -> tuple[str, list[str]]:
    """`pass`, `warn` or `fail`, and why."""
    failures, warnings = [], []
    torn = sum(w.torn for w in windows)
    if windows:
        said = f"{torn} of {len(windows)} windows are torn"
        if torn > FAIL_WINDOWS * len(windows):
            failures.append(said)
        elif torn > WARN_WINDOWS * len(windows):
            warnings.append(said)
        matched = float(np.median([w.bend.matched for w in windows]))
        if matched < LEAST_MATCHED:
            failures.append(f"only {matched:.0%} of the points are seen twice: nothing overlaps")
    sure = [r for r in revisits if r.revisit.sure]
    off = [r for r in sure if r.torn]
    row = any(a.torn and b.torn for a, b in itertools.pairwise(sure))  # one alone may be a place that looks like another
    if row or len(off) > WARN_REVISITS * len(sure):
        worst = max(r.revisit.distance_m for r in off)
        said = f"{len(off)} of {len(sure)} revisits are torn, by up to {worst:.2f} m"
        (failures if len(off) > FAIL_REVISITS * len(sure) else warnings).append(said)
    if failures or warnings:
        return ("fail" if failures else "warn"), failures + warnings
    return "pass", [
        f"{torn} of {len(windows)} windows are torn",
        f"{len(off)} of {len(sure)} revisits are torn" if sure else _unjudged(revisits),
    ]


def _unjudged(revisits: list[RevisitAudit]) -> str:
    """Why no revisit shows the map's drift."""
    if revisits:
        return f"none of {len(revisits)} revisits is sure enough to show its drift"
    return "it comes back to no place that would show its drift"
