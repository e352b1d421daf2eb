"""An audit: every window and every revisit of a map judged, and what they make of the whole."""

from __future__ import annotations

from dataclasses import dataclass

from mqslam.auditing.findings import judge_map
from mqslam.auditing.revisits import RevisitAudit, audit_revisits
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.verdict import VerdictStatus
from mqslam.auditing.windows import WindowAudit, audit_windows
from mqslam.config import AuditConfig, EstimatorConfig, LoopConfig, VerdictConfig
from mqslam.execution.engine import Engine
from mqslam.execution.progress import Progress


@dataclass(frozen=True)
class Audit:
    """The judgement of a map.

    Args:
        windows: its windows in the order of time.
        revisits: places that the trajectory comes back to.
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
    limits: VerdictConfig,
    engine: Engine,
    progress: Progress,
) -> Audit:
    """Judges a map.

    Args:
        sweeps: its points under the trajectory.
        settings: of the audit.
        estimator: settings of the score.
        loops: settings of loops, whose floor holds for revisits too.
        limits: settings of the verdict.
        engine: where windows and revisits are judged; the result does not depend on it.
        progress: called as windows and revisits are done.
    """
    windows = audit_windows(sweeps, settings, estimator, engine, progress)
    revisits = audit_revisits(sweeps, settings, estimator, loops, engine, progress)
    return Audit(windows, revisits, *judge_map(windows, revisits, len(sweeps), settings.window, limits))
