"""An audit: every window, step and revisit of a map judged, and what they make of the whole."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

from mqslam.auditing.findings import judge_pooled, judge_revisits, judge_steps, judge_windows
from mqslam.auditing.pooled import Pooled, pool_corrections
from mqslam.auditing.revisits import RevisitAudit, audit_revisits
from mqslam.auditing.steps import StepAudit, audit_steps
from mqslam.auditing.sweeps import Sweeps, place_sweeps
from mqslam.auditing.verdict import Finding, VerdictStatus, verdict_of
from mqslam.auditing.windows import WindowAudit, audit_windows
from mqslam.config import AuditConfig, Config, EstimatorConfig, LoopConfig, VerdictConfig
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.execution.engine import Engine
from mqslam.execution.progress import Progress
from mqslam.execution.runner import Runner
from mqslam.psi.place import Beam


@dataclass(frozen=True)
class Audit:
    """The judgement of a map.

    Args:
        windows: its windows in the order of time.
        steps: its steps in the order of time.
        pooled: what all of it asks for together; None where the drive is too short to show it.
        revisits: places that the trajectory comes back to.
        tests: what each test found, by its name.
        status: the verdict.
        reasons: why.
    """

    windows: list[WindowAudit]
    steps: list[StepAudit]
    pooled: Pooled | None
    revisits: list[RevisitAudit]
    tests: dict[str, list[Finding]]
    status: VerdictStatus
    reasons: list[str]


def audit(
    sweeps: Sweeps,
    settings: AuditConfig,
    estimator: EstimatorConfig,
    loops: LoopConfig,
    limits: VerdictConfig,
    engine: Engine,
    progress: Progress,
    sampled: int | None = None,
) -> Audit:
    """Judges a map.

    Args:
        sweeps: its points under the trajectory.
        settings: of the audit.
        estimator: settings of the score.
        loops: settings of loops, whose floor holds for revisits too.
        limits: settings of the verdict.
        engine: where windows and revisits are judged; the result does not depend on it.
        progress: called as its parts are done.
        sampled: how many windows at most are judged, evenly spread; None takes all.
    """
    windows = audit_windows(sweeps, settings, estimator, engine, progress, sampled)
    steps = audit_steps(sweeps, settings, estimator, engine, progress)
    pooled = pool_corrections(sweeps, settings, estimator, engine, progress)
    revisits = audit_revisits(sweeps, settings, estimator, loops, engine, progress)
    tests = {
        "windows": judge_windows(windows, len(sweeps), settings.window, limits),
        "steps": [judge_steps(steps, settings, limits)],
        "pooled": [judge_pooled(pooled, limits)],
        "revisits": [judge_revisits(revisits, limits)],
    }
    return Audit(windows, steps, pooled, revisits, tests, *verdict_of(chain.from_iterable(tests.values())))


def audit_trajectory(scans: Scans, trajectory: Trajectory, config: Config, beam: Beam, runner: Runner) -> Audit:
    """Judges the map that a run has made: all of it, but of its windows a sample.

    Args:
        scans: of the recording.
        trajectory: poses of the sensor.
        config: all settings.
        beam: the sensor's errors.
        runner: where the map is judged; the result does not depend on it.

    Raises:
        EstimationError: there are no returns.
    """
    sweeps, _ = place_sweeps(scans, trajectory, config.audit, beam)
    sections = config.audit, config.estimator, config.loops, config.verdict
    return audit(sweeps, *sections, runner.engine, runner.progress, config.audit.sampled_windows)
