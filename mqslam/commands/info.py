"""The description of a recording in values that JSON can hold."""

from __future__ import annotations

from typing import Any

import numpy as np

from mqslam.core.recording import Recording
from mqslam.core.sensors.lidar import LidarRecording
from mqslam.core.trajectory import Trajectory


def describe_radar(recording: Recording) -> dict[str, Any]:
    """Describes a radar recording in numbers and strings that JSON can hold; only its first polar scan is read.

    Returns:
        format, path, revolutions, duration_s [s], turn_rate_hz [1/s], azimuths and bins of the first polar scan,
        range_resolution_m and max_range_m [m], odometry and ground_truth (None, or poses and length_m [m]), gaps
        (after_revolution, counted from 0, and missing_s [s]), notes and faults.

    Raises:
        DataError: the first polar scan cannot be read.
    """
    azimuths, bins = recording[0].power.shape
    return {
        "format": recording.format,
        "path": str(recording.path),
        "revolutions": len(recording),
        "duration_s": recording.duration_s,
        "turn_rate_hz": 1.0 / recording.revolution_s,
        "azimuths": azimuths,
        "bins": bins,
        "range_resolution_m": recording.range_resolution,
        "max_range_m": bins * recording.range_resolution,
        "odometry": _describe_extent(recording.odometry),
        "ground_truth": _describe_extent(recording.ground_truth),
        "gaps": [{"after_revolution": k, "missing_s": missing} for k, missing in recording.gaps()],
        "notes": list(recording.notes),
        "faults": list(recording.faults),
    }


def describe_lidar(lidar: LidarRecording) -> dict[str, Any]:
    """Describes a lidar's recording in numbers and strings that JSON can hold.

    Returns:
        format, path, scans, duration_s [s], scan_rate_hz [1/s], returns per scan, max_range_m [m] among them, odometry and
        recording (the poses beside the scans), and notes.
    """
    steps = np.diff(lidar.scans.stamps_us) * 1e-6
    return {
        "format": lidar.format,
        "path": str(lidar.path),
        "scans": len(lidar.scans),
        "duration_s": float(steps.sum()),
        "scan_rate_hz": 1.0 / float(np.median(steps)),
        "returns": float(np.mean([len(scan.returns) for scan in lidar.scans])),
        "max_range_m": max(float(scan.returns.ranges.max(initial=0.0)) for scan in lidar.scans),
        "odometry": _describe_extent(lidar.odometry),
        "recording": _describe_extent(lidar.trajectory),
        "notes": list(lidar.notes),
    }


def _describe_extent(trajectory: Trajectory | None) -> dict[str, Any] | None:
    """Returns the number of poses and the length [m] of a trajectory, or None."""
    return None if trajectory is None else {"poses": len(trajectory), "length_m": trajectory.length_m}
