"""The odometry front end: a dead-reckoned or given trajectory, cut into relative motions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement
from mqslam.core.scans import Scan
from mqslam.errors import EstimationError

# what a wheel odometry of which nothing is known is taken to be worth; the graph estimates better where it can
SIGMA_TRAVEL = 0.05  # standard deviation of travel, per metre
SIGMA_REST_M = 0.01  # standard deviation of the position over a window at rest [m]
SIGMA_YAW_RATE = 0.02  # standard deviation of the yaw rate [rad/s]


class OdometryFrontEnd:
    """Reads motions off the odometry of the context."""

    def __init__(self, context: Context) -> None:
        if context.odometry is None:
            raise EstimationError("the odometry front end needs odometry; give --odometry FILE or another --frontend")
        self._odometry = context.odometry
        self._start_us = context.start_us
        self._slack_us = context.config.reading.track_slack_us

    def measure(self, scans: Iterable[Scan]) -> Iterator[Measurement]:
        """The motion from the start of each window to the start of the next, where the odometry reaches that far.

        Raises:
            EstimationError: the odometry does not cover the windows.
        """
        before: Scan | None = None
        for scan in scans:
            if before is not None:
                yield self._between(before.t0, scan)
            before = scan

    def _between(self, t0: float, scan: Scan) -> Measurement:
        stamps = self._start_us + np.round(np.array([t0, scan.t0]) * 1e6).astype(np.int64)
        if not self._odometry.covers(int(stamps[0]), int(stamps[1]), self._slack_us):
            raise EstimationError(f"the odometry does not cover {t0:.2f} s to {scan.t0:.2f} s of the recording")
        first, last = self._odometry.at(stamps)
        pose = se2.between(first, last)
        along = SIGMA_REST_M + SIGMA_TRAVEL * float(np.hypot(pose[0], pose[1]))
        yaw = SIGMA_YAW_RATE * (scan.t0 - t0)
        return Measurement(t0, scan.t0, pose, np.diag([along**2, along**2, yaw**2]), points=len(scan.returns))
