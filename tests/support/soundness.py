"""What holds of whatever a reader makes of a damaged input."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mqslam.config import Config
from mqslam.core.point_map import TimedCloud
from mqslam.core.recording import LidarRecording, PolarScan, Recording
from mqslam.core.scans import Returns
from mqslam.core.sensors import Fixes, Gyroscope
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_stretch
from mqslam.formats.covariances import read_covariances
from mqslam.formats.graphs.g2o import read_g2o
from mqslam.formats.maps.keyframe_folder import read_keyframes
from mqslam.formats.maps.nav2_map import read_nav2_map
from mqslam.formats.recordings import open_recording

_MOST = 10_000_000  # elements of an array that so small a file can mean


def check_radar(format: str) -> Callable[[Path], None]:
    def read(path: Path) -> None:
        recording = open_recording(path, format=format)
        check_recording(recording)
        config, checked = Config(), _Checked(recording)
        detected = detect_stretch(checked, config.detector, 0, len(recording), strict=False, with_velocities=True)  # type: ignore[arg-type]
        assert len(detected.returns) == len(recording)
        assert detected.velocities is not None and len(detected.velocities) == len(recording)
        assert np.array_equal(np.isfinite(detected.velocities.covariances).all(axis=(1, 2)), detected.velocities.measured)
        for returns in detected.returns:
            check_returns(returns)

    return read


class _Checked:
    """A recording whose polar scans are checked as they are read."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self.path, self.range_resolution = recording.path, recording.range_resolution
        self.range_offset = recording.range_offset
        self.start_us, self.stamps_us, self.turns_us = recording.start_us, recording.stamps_us, recording.turns_us

    def polar_scans(self, start: int, stop: int) -> Any:
        for polar_scan in self._recording.polar_scans(start, stop):
            check_polar_scan(polar_scan)
            yield polar_scan


def check_recording(recording: Recording) -> None:
    assert recording.stamps_us.dtype == np.int64 and 0 < len(recording) < _MOST
    assert np.all(np.diff(recording.stamps_us) > 0) and recording.end_us > recording.stamps_us[-1]
    assert np.isfinite(recording.range_resolution) and recording.range_resolution > 0.0
    assert np.isfinite(recording.range_offset)
    for track in (recording.odometry, recording.ground_truth):
        if track is not None:
            check_trajectory(track)
    if recording.gyroscope is not None:
        check_gyroscope(recording.gyroscope)
    if recording.fixes is not None:
        check_fixes(recording.fixes)
    assert recording.mount is None or (recording.mount.pose.shape == (3,) and np.isfinite(recording.mount.pose).all())
    assert all(isinstance(text, str) and text for text in (*recording.notes, *recording.faults))


def check_gyroscope(gyroscope: Gyroscope) -> None:
    assert 2 <= len(gyroscope) < _MOST and gyroscope.rates.shape == (len(gyroscope), 3)
    assert np.isfinite(gyroscope.rates).all() and np.all(np.diff(gyroscope.stamps_us) > 0)


def check_fixes(fixes: Fixes) -> None:
    assert 1 <= len(fixes) < _MOST and np.all(np.diff(fixes.stamps_us) > 0)
    assert np.all(np.abs(fixes.latitudes) <= 90.0) and np.all(np.abs(fixes.longitudes) <= 180.0)
    assert fixes.sigmas_m.shape == fixes.latitudes.shape == fixes.longitudes.shape == (len(fixes),)
    assert not np.any(fixes.sigmas_m <= 0.0) and not np.isinf(fixes.sigmas_m).any()


def check_polar_scan(polar_scan: PolarScan) -> None:
    rows = len(polar_scan.power)
    assert polar_scan.power.ndim == 2 and polar_scan.power.dtype == np.uint8 and polar_scan.power.size < 8 * _MOST
    assert polar_scan.times.shape == polar_scan.azimuths.shape == polar_scan.valid.shape == (rows,)
    assert np.isfinite(polar_scan.times).all() and np.isfinite(polar_scan.azimuths).all()
    assert np.all(np.diff(polar_scan.times) >= 0.0)
    if polar_scan.down is not None:
        check_polar_scan(polar_scan.down)


def check_returns(returns: Returns) -> None:
    for values in (returns.ranges, returns.azimuths, returns.times, returns.intensities):
        assert values.shape == returns.ranges.shape and np.isfinite(values).all()


def check_trajectory(track: Trajectory) -> None:
    assert 2 <= len(track) < _MOST and track.poses.shape == (len(track), 3)
    assert np.isfinite(track.poses).all() and np.all(np.diff(track.stamps_us) > 0)


def check_lidar(lidar: LidarRecording) -> None:
    assert 2 <= len(lidar.scans) == len(lidar.scans.stamps_us) < _MOST and np.all(np.diff(lidar.scans.stamps_us) > 0)
    for scan in lidar.scans:
        assert np.isfinite([scan.t0, scan.t1]).all() and scan.t1 >= scan.t0
        check_returns(scan.returns)
    for track in (lidar.trajectory, lidar.odometry):
        if track is not None:
            check_trajectory(track)


def check_cloud(cloud: TimedCloud) -> None:
    assert 0 < len(cloud) < _MOST and cloud.points.shape == (len(cloud), 2) and np.isfinite(cloud.points).all()
    assert cloud.stamps_us.shape == (len(cloud),) and np.all(np.diff(cloud.stamps_us) >= 0)


def check_covariances(path: Path) -> None:
    given = read_covariances(path)
    assert np.all(np.diff(given.stamps_us) > 0)
    assert given.covariances.shape == (len(given.stamps_us), 3, 3) and np.isfinite(given.covariances).all()


def check_pose_graph(path: Path) -> None:
    stored = read_g2o(path)
    assert set(stored.held) <= set(stored.keys) and len(stored.keys) == stored.values.size()
    assert stored.factors.size() > 0 and np.isfinite(stored.factors.error(stored.values))


def check_keyframes(path: Path) -> None:
    made = read_keyframes(path)
    frames = made.keyframes
    assert 0 < len(frames.poses) < _MOST and np.isfinite(frames.poses).all()
    assert np.all(frames.rows[:, 0] <= frames.rows[:, 1]) and frames.rows.max() <= len(frames.points)
    assert len(made.places.keyframes) == len(made.places.descriptors)


def check_nav2_map(path: Path) -> None:
    grid = read_nav2_map(path)
    assert grid.cells.ndim == 2 and grid.cells.size < _MOST
    assert np.isfinite(grid.origin).all() and 0.0 < grid.resolution < np.inf
