"""Windows of a run judged where it passes: enough to see how good its map is, whatever its length."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from mqslam.audit.judge import WindowAudit, audit_window
from mqslam.audit.sweeps import swept
from mqslam.config import Config
from mqslam.detection import Progress
from mqslam.errors import EstimationError
from mqslam.returns import Window
from mqslam.trajectory import Trajectory

MOST = 100  # windows of a run that are judged


def judged_sample(
    windows: Sequence[Window], start_us: int, period_s: float, trajectory: Trajectory, config: Config, jobs: int,
    progress: Progress,
) -> list[WindowAudit]:  # fmt: skip
    """At most `MOST` windows of a recording, evenly spread, under a trajectory; those without returns are left out.

    Args:
        windows: one per revolution.
        start_us: stamp [us] of their time zero.
        period_s: duration of a revolution [s].
        trajectory: poses of the sensor.
        config: all settings.
        jobs: threads; the result does not depend on it.
        progress: called as windows are done.
    """
    size = config.audit.window
    begins = np.arange(0, len(windows) - size + 1, size)
    if len(begins) > MOST:
        begins = begins[np.linspace(0, len(begins) - 1, MOST).round().astype(np.int64)]

    def judged(begin: int) -> WindowAudit | None:
        try:
            sweeps, inside = swept(windows[begin : begin + size], start_us, period_s, trajectory, config)
        except EstimationError:
            return None
        found = audit_window(sweeps, 0, len(sweeps), config)
        return replace(found, begin=begin + inside[0], end=begin + inside[-1] + 1)

    found: list[WindowAudit] = []
    with ThreadPoolExecutor(jobs) as pool:
        for number, window in enumerate(pool.map(judged, begins.tolist()), 1):
            if window is not None:
                found.append(window)
            progress("check", number, len(begins))
    return found
