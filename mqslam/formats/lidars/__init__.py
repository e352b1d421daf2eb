"""Reads recordings of planar lidars, which can be audited and described: CARMEN logs, and laser scans in ROS bags."""

from __future__ import annotations

from pathlib import Path

from mqslam.config import USUAL_READING, ReadingConfig
from mqslam.core.recording import LidarRecording
from mqslam.errors import untrusted
from mqslam.formats import bags
from mqslam.formats.lidars import carmen, laserscan


@untrusted.reads_file
def recognises(path: Path) -> bool:
    """Returns whether the path is a CARMEN log, or a bag with laser scans and nothing that a radar sent.

    Raises:
        DataError: the path is a bag that cannot be read.
    """
    return carmen.recognises(path) or (bags.recognises(path) and laserscan.holds_scans(path))


@untrusted.reads_file
def read_lidar(path: Path, settings: ReadingConfig = USUAL_READING) -> LidarRecording:
    """Reads a recording of a planar lidar for which `recognises` is true.

    Args:
        path: the recording.
        settings: how recordings are understood.

    Raises:
        DataError: the recording cannot be used.
    """
    return carmen.read_lidar(path, settings) if carmen.recognises(path) else laserscan.read_lidar(path, settings)
