"""Describes a recording by numbers and texts that JSON can hold."""

from __future__ import annotations

from typing import Any

import numpy as np

from mqslam.core.recording import LidarRecording, Recording
from mqslam.core.sensors import Fixes, Gyroscope, Mount
from mqslam.core.trajectory import Trajectory


def describe_radar(recording: Recording) -> dict[str, Any]:
    """Describes a radar recording by numbers and texts that JSON can hold; reads only the first polar scan.

    Returns:
        format, path, revolutions (their number), duration_s [s], turn_rate_hz [1/s], azimuths and bins (their numbers in the
        first polar scan), range_resolution_m and max_range_m [m], odometry and ground_truth (each None, or the number
        of poses and length_m [m]), gyroscope and gnss (each None, or the number of readings, rate_hz [1/s], span_s [s] and
        source; for gnss also made_truth), mount (None, or x_m, y_m [m], yaw_deg [degrees] and source), gaps (a list of
        after_revolution, counted from 0, and missing_s [s]), notes and faults.

    Raises:
        DataError: the first polar scan cannot be read.
    """
    azimuths, bins = recording[0].power.shape
    fixes = recording.fixes
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
        "gyroscope": None if recording.gyroscope is None else _describe_sensor(recording.gyroscope),
        "gnss": None if fixes is None else {**_describe_sensor(fixes), "made_truth": fixes.made_truth},
        "mount": None if recording.mount is None else _describe_mount(recording.mount),
        "gaps": [{"after_revolution": k, "missing_s": missing} for k, missing in recording.gaps()],
        "notes": list(recording.notes),
        "faults": list(recording.faults),
    }


def describe_lidar(lidar: LidarRecording) -> dict[str, Any]:
    """Describes a lidar's recording by numbers and texts that JSON can hold.

    Returns:
        format, path, scans (their number), duration_s [s], scan_rate_hz [1/s], returns (mean number per scan), max_range_m
        (range of the farthest return [m]), odometry, recording (the trajectory that comes with the scans), both None or the
        number of poses and length_m [m], and notes.
    """
    steps = np.diff(lidar.scans.stamps_us) * 1e-6
    return {
        "format": lidar.format,
        "path": str(lidar.path),
        "scans": len(lidar.scans),
        "duration_s": lidar.duration_s,
        "scan_rate_hz": 1.0 / float(np.median(steps)),
        "returns": float(np.mean([len(scan.returns) for scan in lidar.scans])),
        "max_range_m": max(float(scan.returns.ranges.max(initial=0.0)) for scan in lidar.scans),
        "odometry": _describe_extent(lidar.odometry),
        "recording": _describe_extent(lidar.trajectory),
        "notes": list(lidar.notes),
    }


def _describe_extent(trajectory: Trajectory | None) -> dict[str, Any] | None:
    """Returns the number of poses and the length [m] of a trajectory; None without a trajectory."""
    return None if trajectory is None else {"poses": len(trajectory), "length_m": trajectory.length_m}


def _describe_sensor(sensor: Gyroscope | Fixes) -> dict[str, Any]:
    """Returns the number of a sensor's readings, their rate (None for a single one), their time span and their source."""
    return {
        "readings": len(sensor),
        "rate_hz": sensor.rate_hz if len(sensor) > 1 else None,
        "span_s": float(sensor.stamps_us[-1] - sensor.stamps_us[0]) * 1e-6,
        "source": sensor.source,
    }


def _describe_mount(mount: Mount) -> dict[str, Any]:
    """Returns the pose of the radar on the vehicle (x forward, y and yaw to the left), and the source of this pose."""
    x, y, yaw = mount.pose.tolist()
    return {"x_m": x, "y_m": y, "yaw_deg": float(np.degrees(yaw)), "source": mount.source}
