"""The odometry front end: it cuts a dead-reckoned or given trajectory into relative motions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise

import numpy as np

from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement
from mqslam.core.scans import Scan
from mqslam.errors import EstimationError, Remedy

# Standard deviation of the position over a scan at rest [m], which the resolution and the slack of wheel encoders cause.
SIGMA_REST_M = 0.01


class OdometryFrontEnd:
    """A front end that takes the motions from the odometry of the context.

    Args:
        context: holds the odometry.

    Raises:
        EstimationError: there is no odometry.
    """

    def __init__(self, context: Context) -> None:
        if context.odometry is None:
            raise EstimationError("the odometry front end needs odometry", Remedy.GIVE_ODOMETRY)
        self._odometry = context.odometry
        self._start_us = context.start_us
        self._settings = context.config.odometry

    def measure(self, scans: Iterable[Scan]) -> Iterator[Measurement]:
        """Measures the motion from the start of each scan to the start of the next.

        Raises:
            EstimationError: the odometry does not cover the scans.
        """
        for before, scan in pairwise(scans):
            t0 = before.t0
            stamps = self._start_us + np.round(np.array([t0, scan.t0]) * 1e6).astype(np.int64)
            if not self._odometry.covers(int(stamps[0]), int(stamps[1])):
                raise EstimationError(f"the odometry does not cover {t0:.2f} s to {scan.t0:.2f} s; give odometry that does")
            first, last = self._odometry.at(stamps)
            pose = se2.wrapped_between(first, last)
            along = SIGMA_REST_M + self._settings.sigma_travel * float(np.hypot(pose[0], pose[1]))
            yaw = self._settings.sigma_yaw_rate * (scan.t0 - t0)
            yield Measurement(t0, scan.t0, pose, np.diag([along**2, along**2, yaw**2]), points=len(scan.returns))
