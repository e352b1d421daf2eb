"""The KISS-ICP front end: point-to-point ICP on planar radar returns, for comparison."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from mqslam import se2
from mqslam.frontend import Context
from mqslam.measurement import RelativeMotion
from mqslam.returns import Window


class KissIcpFrontEnd:
    """Feeds each revolution to KISS-ICP as a planar scan with per-point times."""

    def __init__(self, context: Context) -> None:
        from kiss_icp.config import KISSConfig
        from kiss_icp.kiss_icp import KissICP

        self._settings = context.config.kiss_icp
        config = KISSConfig()
        config.mapping.voxel_size = self._settings.voxel_size_m
        config.data.max_range = self._settings.max_range_m
        config.data.min_range = 0.0
        config.data.deskew = self._settings.deskew
        config.registration.max_num_threads = 1
        self._odometry = KissICP(config)

    def measure(self, windows: Iterable[Window]) -> Iterator[RelativeMotion]:
        """The motion from the start of each window to the start of the next."""
        before: tuple[Window, se2.Array] | None = None
        for window in windows:
            returns = window.returns
            points = np.zeros((len(returns), 3))
            points[:, 0] = returns.ranges * np.cos(returns.azimuths)
            points[:, 1] = returns.ranges * np.sin(returns.azimuths)
            self._odometry.register_frame(points, (returns.times - window.t0) / (window.t1 - window.t0))
            pose4 = self._odometry.last_pose
            pose = np.array([pose4[0, 3], pose4[1, 3], np.arctan2(pose4[1, 0], pose4[0, 0])])
            if before is not None:
                motion = se2.between(before[1], pose)
                motion[2] = se2.wrap(motion[2])
                yield RelativeMotion(
                    before[0].t0,
                    window.t0,
                    motion,
                    np.diag([self._settings.sigma_m**2, self._settings.sigma_m**2, self._settings.sigma_yaw**2]),
                    points=len(returns),
                )
            before = (window, pose)
