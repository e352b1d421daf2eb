"""Recordings of planar lidars, which are audited and described; the layouts there are."""

from __future__ import annotations

from pathlib import Path

from mqslam.core.lidar import LidarRecording
from mqslam.formats.lidars import carmen, laserscan
from mqslam.formats.shared import bags


def recognises(path: Path) -> bool:
    """Whether the path is a CARMEN log, or a bag with laser scans and nothing that a radar sent.

    Raises:
        DataError: a bag that cannot be read.
    """
    return carmen.recognises(path) or (bags.recognises(path) and laserscan.holds_scans(path))


def read_lidar(path: Path) -> LidarRecording:
    """Read a recording that is recognised.

    Raises:
        DataError: it cannot be used.
    """
    return carmen.read_lidar(path) if carmen.recognises(path) else laserscan.read_lidar(path)
