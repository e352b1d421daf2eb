"""Recordings of a planar lidar: ranges as they are, nothing to detect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mqslam.core.scans import Returns, Scan
from mqslam.core.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class LidarRecording:
    """A planar lidar's scans.

    Args:
        path: the recording.
        format: name of its layout: carmen or laserscan.
        stamps_us: (N,) int64 [us], stamp of the first beam of every scan, strictly increasing.
        scans: one per scan, from its stamp to the next scan's; times count from the first scan's stamp [s],
            intensities are 0 where the recording has none.
        trajectory: poses of the sensor that some SLAM wrote beside the scans, or None.
        odometry: dead-reckoned poses of the sensor that the recording carries, or None.
        notes: what a user should know about how the recording was understood.
    """

    path: Path
    format: str
    stamps_us: NDArray[np.int64]
    scans: list[Scan]
    trajectory: Trajectory | None
    odometry: Trajectory | None
    notes: tuple[str, ...]


def scans_of(stamps_us: NDArray[np.int64], scans: Sequence[Returns]) -> list[Scan]:
    """Scans as windows that end where the next one begins; the last ends a median step after its stamp.

    Args:
        stamps_us: (N,) [us], strictly increasing, two at least.
        scans: N scans.
    """
    starts = (stamps_us - stamps_us[0]) * 1e-6
    edges = np.append(starts, starts[-1] + np.median(np.diff(starts))).tolist()
    return [Scan(t0, t1, scan) for t0, t1, scan in zip(edges[:-1], edges[1:], scans, strict=True)]
