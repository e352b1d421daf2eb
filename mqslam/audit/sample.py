"""Windows of a run judged where it passes: enough to see how good its map is, whatever its length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mqslam.audit.judge import WindowAudit, audit_window
from mqslam.audit.sweeps import swept
from mqslam.config import Config
from mqslam.core.evenly import evenly
from mqslam.core.scans import Scan
from mqslam.core.trajectory import Trajectory
from mqslam.errors import EstimationError
from mqslam.execution.engine import Engine
from mqslam.execution.progress import Progress

MOST = 100  # windows of a run that are judged


def judged_sample(
    scans: Sequence[Scan], start_us: int, revolution_s: float, trajectory: Trajectory, config: Config, engine: Engine,
    progress: Progress,
) -> list[WindowAudit]:  # fmt: skip
    """At most `MOST` windows of a recording, evenly spread, under a trajectory; those without returns are left out.

    Args:
        scans: one per revolution.
        start_us: stamp [us] of their time zero.
        revolution_s: duration of a revolution [s].
        trajectory: poses of the sensor.
        config: all settings.
        engine: where they are judged; the result does not depend on it.
        progress: called as windows are done.
    """
    size = config.audit.window
    begins = np.arange(0, len(scans) - size + 1, size)
    begins = begins[evenly(len(begins), MOST)]

    def done(number: int, window: WindowAudit | None) -> None:
        progress("check", number, len(begins))

    found = engine.map(_judged, (scans, start_us, revolution_s, trajectory, config), begins.tolist(), done)
    return [window for window in found if window is not None]


def _judged(shared: tuple[Sequence[Scan], int, float, Trajectory, Config], begin: int) -> WindowAudit | None:
    """The window that begins with a revolution; None without returns."""
    scans, start_us, revolution_s, trajectory, config = shared
    stretch = scans[begin : begin + config.audit.window]
    try:
        sweeps, inside = swept(stretch, start_us, revolution_s, trajectory, config)
    except EstimationError:
        return None
    found = audit_window(sweeps, 0, len(sweeps), config)
    return replace(found, begin=begin + inside[0], end=begin + inside[-1] + 1)
