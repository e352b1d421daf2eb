"""Recordings of a planar lidar, whose ranges are returns as they are, without a detector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core.scans import Returns, Scan, Scans
from mqslam.core.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class LidarRecording:
    """A planar lidar's scans.

    Args:
        path: the recording.
        format: name of its layout: carmen or laserscan.
        scans: each from the stamp of its first beam to the next scan's; times count from the first scan's stamp [s],
            intensities are 0 where the recording has none.
        trajectory: poses of the sensor that some SLAM system wrote beside the scans, or None.
        odometry: dead-reckoned poses of the sensor that the recording carries, or None.
        notes: what a user should know about how the recording was understood.
    """

    path: Path
    format: str
    scans: Scans
    trajectory: Trajectory | None
    odometry: Trajectory | None
    notes: tuple[str, ...]


def stamp_scans(stamps_us: NDArray[np.int64], returns: Sequence[Returns]) -> Scans:
    """Returns scans that end where the next one begins; the last ends a median step after its stamp.

    Args:
        stamps_us: (N,) [us], strictly increasing, at least two.
        returns: of each of the N scans.
    """
    starts = (stamps_us - stamps_us[0]) * 1e-6
    edges = np.append(starts, starts[-1] + np.median(np.diff(starts))).tolist()
    scans = tuple(Scan(t0, t1, seen) for t0, t1, seen in zip(edges[:-1], edges[1:], returns, strict=True))
    return Scans(scans, int(stamps_us[0]), float(np.median(np.diff(stamps_us))) * 1e-6)
