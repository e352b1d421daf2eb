"""Windows of a run judged where it passes: enough to see how good its map is, whatever its length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mqslam.audit.judge import WindowAudit, audit_window
from mqslam.audit.sweeps import swept
from mqslam.config import Config
from mqslam.core.evenly import evenly
from mqslam.core.scans import Window
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import Progress
from mqslam.errors import EstimationError
from mqslam.execution.engine import Engine

MOST = 100  # windows of a run that are judged


def judged_sample(
    windows: Sequence[Window], start_us: int, period_s: float, trajectory: Trajectory, config: Config, engine: Engine,
    progress: Progress,
) -> list[WindowAudit]:  # fmt: skip
    """At most `MOST` windows of a recording, evenly spread, under a trajectory; those without returns are left out.

    Args:
        windows: one per revolution.
        start_us: stamp [us] of their time zero.
        period_s: duration of a revolution [s].
        trajectory: poses of the sensor.
        config: all settings.
        engine: where they are judged; the result does not depend on it.
        progress: called as windows are done.
    """
    size = config.audit.window
    begins = np.arange(0, len(windows) - size + 1, size)
    begins = begins[evenly(len(begins), MOST)]

    def done(number: int, window: WindowAudit | None) -> None:
        progress("check", number, len(begins))

    found = engine.map(_judged, (windows, start_us, period_s, trajectory, config), begins.tolist(), done)
    return [window for window in found if window is not None]


def _judged(shared: tuple[Sequence[Window], int, float, Trajectory, Config], begin: int) -> WindowAudit | None:
    """The window that begins with a revolution; None without returns."""
    windows, start_us, period_s, trajectory, config = shared
    stretch = windows[begin : begin + config.audit.window]
    try:
        sweeps, inside = swept(stretch, start_us, period_s, trajectory, config)
    except EstimationError:
        return None
    found = audit_window(sweeps, 0, len(sweeps), config)
    return replace(found, begin=begin + inside[0], end=begin + inside[-1] + 1)
