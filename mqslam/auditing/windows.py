"""The windows of a map, each judged against its own best."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from mqslam.auditing.inflation import Bend, fit_bend
from mqslam.auditing.measures import Measures, compute_measures, locate_sensors
from mqslam.auditing.sweeps import Sweeps, place_sweeps
from mqslam.config import AuditConfig, EstimatorConfig
from mqslam.core import se2
from mqslam.core.evenly import pick_evenly
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.errors import EstimationError
from mqslam.execution.engine import Engine
from mqslam.execution.progress import Progress
from mqslam.execution.runner import Runner
from mqslam.psi.place import Beam


@dataclass(frozen=True, slots=True)
class WindowAudit:
    """The judgement of one window.

    Args:
        begin, end: its sweeps, begin <= k < end.
        t0, t1: when it begins and ends [s] since the recording's start.
        pose: (3,) of the sensor at its middle, world frame.
        bend: the correction that would make its map the best.
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


def audit_windows(
    sweeps: Sweeps, settings: AuditConfig, estimator: EstimatorConfig, engine: Engine, progress: Progress
) -> list[WindowAudit]:
    """Judges the windows of a map in the order of time; windows without a point, such as in fog, are left out.

    Args:
        sweeps: points under the trajectory to judge.
        settings: of the audit.
        estimator: settings of the score.
        engine: where the windows are judged; the result does not depend on it.
        progress: called as windows are done.
    """
    size = settings.window
    begins = list(range(0, len(sweeps) - size + 1, size))
    if begins and begins[-1] + size < len(sweeps):
        begins.append(len(sweeps) - size)  # the last one overlaps the one before, so that every sweep is judged
    begins = [begin for begin in begins if sweeps.begins[begin + size] > sweeps.begins[begin]]

    def report(number: int, window: WindowAudit) -> None:
        progress("audit", number, len(begins))

    return engine.map(_audit_from, (sweeps, settings, estimator), begins, report)


def _audit_from(shared: tuple[Sweeps, AuditConfig, EstimatorConfig], begin: int) -> WindowAudit:
    """Judges the window that begins with a sweep."""
    sweeps, settings, estimator = shared
    return audit_window(sweeps, begin, begin + settings.window, settings, estimator)


def audit_window(sweeps: Sweeps, begin: int, end: int, settings: AuditConfig, estimator: EstimatorConfig) -> WindowAudit:
    """Judges one window.

    Args:
        sweeps: points under the trajectory to judge.
        begin: first sweep of the window.
        end: the sweep after its last one.
        settings: of the audit.
        estimator: settings of the score.
    """
    span = sweeps.span(begin, end)
    turns = sweeps.turns[span]
    bend = fit_bend(sweeps, begin, end, settings, estimator)
    measures = compute_measures(
        sweeps.points[span],
        np.searchsorted(sweeps.numbers[begin:end], turns, side="right"),
        locate_sensors(turns, sweeps.numbers, sweeps.poses),
        settings,
    )
    is_bent = bend.inflation > torn_threshold(settings) and bend.size_m > settings.bend_m
    return WindowAudit(
        begin=begin,
        end=end,
        t0=float(sweeps.times[begin]),
        t1=float(sweeps.times[end - 1] + sweeps.revolution_s),
        pose=sweeps.poses[(begin + end) // 2],
        bend=bend,
        measures=measures,
        torn=bool(is_bent or bend.matched_best < settings.overlap),
    )


def torn_threshold(settings: AuditConfig) -> float:
    """Returns the inflation beyond which a window or a revisit is off by more than chance: it has 3 degrees of freedom."""
    return float(chi2.ppf(settings.probability, 3))


def audit_sample(
    scans: Scans,
    trajectory: Trajectory,
    settings: AuditConfig,
    estimator: EstimatorConfig,
    beam: Beam,
    runner: Runner,
) -> list[WindowAudit]:
    """Judges some windows of a run, evenly spread: enough to see how good its map is, whatever its length.

    Args:
        scans: of the recording; windows without returns are left out.
        trajectory: poses of the sensor.
        settings: of the audit, which say how many windows at most.
        estimator: settings of the score.
        beam: the sensor's errors.
        runner: where the windows are judged; the result does not depend on it.
    """
    size = settings.window
    begins = np.arange(0, len(scans) - size + 1, size)
    begins = begins[pick_evenly(len(begins), settings.sampled_windows)]

    def report(number: int, window: WindowAudit | None) -> None:
        runner.progress("check", number, len(begins))

    windows = runner.engine.map(_audit_part, (scans, trajectory, settings, estimator, beam), begins.tolist(), report)
    return [window for window in windows if window is not None]


def _audit_part(shared: tuple[Scans, Trajectory, AuditConfig, EstimatorConfig, Beam], begin: int) -> WindowAudit | None:
    """Judges the window that begins with a scan; returns None where it holds no returns."""
    scans, trajectory, settings, estimator, beam = shared
    try:
        sweeps, inside = place_sweeps(scans[begin : begin + settings.window], trajectory, settings, beam)
    except EstimationError:
        return None
    window = audit_window(sweeps, 0, len(sweeps), settings, estimator)
    return replace(window, begin=begin + inside[0], end=begin + inside[-1] + 1)
