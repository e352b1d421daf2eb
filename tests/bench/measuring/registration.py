"""KISS-ICP's own registration of a recording's returns, without a front end around it."""

from __future__ import annotations

import numpy as np

from mqslam.config import Config
from mqslam.core.scans import Scans


def register(scans: Scans) -> None:
    """Follows the scans by KISS-ICP alone, with a voxel size and a range as its front end has them, and one thread."""
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP

    settings, config = Config().kiss_icp, KISSConfig()
    config.mapping.voxel_size, config.data.max_range = settings.voxel_size_m, settings.max_range_m
    config.data.min_range = 0.0
    config.registration.max_num_threads = 1
    kiss = KissICP(config)
    for scan in scans:
        ranges, azimuths = scan.returns.ranges, scan.returns.azimuths
        points = np.column_stack([ranges * np.cos(azimuths), ranges * np.sin(azimuths), np.zeros(len(ranges))])
        kiss.register_frame(points, (scan.returns.times - scan.t0) / (scan.t1 - scan.t0))
