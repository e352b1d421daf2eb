"""Windows of a run judged where it passes: enough to see how good its map is, whatever its length."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mqslam.audit.judge import WindowAudit, audit_window
from mqslam.audit.sweeps import swept
from mqslam.config import AuditConfig, EstimatorConfig
from mqslam.core.evenly import evenly
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.errors import EstimationError
from mqslam.execution.runner import Runner
from mqslam.psi.place import Beam

MOST = 100  # windows of a run that are judged


def judged_sample(
    scans: Scans,
    trajectory: Trajectory,
    settings: AuditConfig,
    estimator: EstimatorConfig,
    beam: Beam,
    runner: Runner,
) -> list[WindowAudit]:
    """At most `MOST` windows of a recording, evenly spread, under a trajectory; those without returns are left out.

    Args:
        scans: of the recording.
        trajectory: poses of the sensor.
        settings: of the audit.
        estimator: settings of the score.
        beam: the sensor's errors.
        runner: where they are judged; the result does not depend on it.
    """
    size = settings.window
    begins = np.arange(0, len(scans) - size + 1, size)
    begins = begins[evenly(len(begins), MOST)]

    def done(number: int, window: WindowAudit | None) -> None:
        runner.progress("check", number, len(begins))

    found = runner.engine.map(_judged, (scans, trajectory, settings, estimator, beam), begins.tolist(), done)
    return [window for window in found if window is not None]


def _judged(shared: tuple[Scans, Trajectory, AuditConfig, EstimatorConfig, Beam], begin: int) -> WindowAudit | None:
    """The window that begins with a revolution; None without returns."""
    scans, trajectory, settings, estimator, beam = shared
    try:
        sweeps, inside = swept(scans[begin : begin + settings.window], trajectory, beam)
    except EstimationError:
        return None
    found = audit_window(sweeps, 0, len(sweeps), settings, estimator)
    return replace(found, begin=begin + inside[0], end=begin + inside[-1] + 1)
