"""Reads recordings of planar lidars: CARMEN logs, and laser scans in ROS bags."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from mqslam.config import USUAL_READING, ReadingConfig
from mqslam.core.recording import LidarRecording
from mqslam.errors import untrusted
from mqslam.formats.lidars import carmen, laserscan

FORMATS: Final = ("carmen", "laserscan")
"""Names of the layouts of lidars' recordings."""


@untrusted.reads_file
def read_lidar(path: Path, settings: ReadingConfig = USUAL_READING) -> LidarRecording:
    """Reads a recording of a planar lidar: a CARMEN log, or a bag with laser scans.

    Args:
        path: the recording.
        settings: values that the recording may not state, such as the field of view.

    Raises:
        DataError: the recording cannot be used.
    """
    return carmen.read_lidar(path, settings) if carmen.recognises(path) else laserscan.read_lidar(path)
