"""Matches each scan to a map of the last keyframes by a library's registration: the front ends of Open3D and small_gicp."""

from __future__ import annotations

from collections import deque
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.frontends.icp_covariance import Surface
from mqslam.frontends.scan_matching import FEWEST_MATCHED, Matching, PlacedScan, lift

# Number of scans that the map holds.
_KEYFRAMES = 20
# A scan joins the map when the sensor has travelled this far since the last keyframe [m].
_KEYFRAME_M = 2.0
# A scan also joins the map when the sensor has rotated by this much since the last keyframe [rad].
_KEYFRAME_RAD = 0.1
# Reach of the first registration of a scan, in units of the reach of the second.
_FIRST_REACH = 3.0
# Side of a scan's voxels, as a share of the map's.
_SCAN_VOXEL = 0.5


class Registration(Protocol):
    """The functions by which a library makes planar point clouds and registers them on each other."""

    reach_m: float
    """Longest distance between corresponding points [m]."""

    def make_cloud(self, points: NDArray[np.float64], voxel_size_m: float) -> tuple[Any, NDArray[np.float64]]:
        """Downsamples points (N, 2) [m] to one per voxel; returns the library's cloud, and the points (M, 2) [m] in it."""
        ...

    def register(self, source: Any, target: Any, reach_m: float, begin: se2.Array) -> se2.Array:
        """Returns the pose (3,) [m, m, rad] of the cloud `source` in the frame of the cloud `target`.

        Args:
            source: cloud of a scan, as `make_cloud` returns it.
            target: cloud of the map.
            reach_m: longest distance between corresponding points [m].
            begin: (3,) pose at which the registration begins [m, m, rad].
        """
        ...


class KeyframeMatcher:
    """A `ScanMatcher` that registers each scan on a map of the last keyframes: first with a wide reach, then more closely.

    Args:
        registration: the library's registration.
        settings: side of the voxels, and range beyond which returns are dropped.
    """

    reference = 1.0

    def __init__(self, registration: Registration, settings: Matching) -> None:
        self._registration = registration
        self._settings = settings
        self._keyframes: deque[NDArray[np.float64]] = deque(maxlen=_KEYFRAMES)
        self._last_keyframe: se2.Array | None = None
        self._map: tuple[Any, Surface] | None = None

    def match(
        self, points: NDArray[np.float64], fractions: NDArray[np.float64], before: se2.Array, motion: se2.Array
    ) -> PlacedScan | None:
        """Matches a scan, and adds it to the map if it is far enough from the last keyframe; see `ScanMatcher`."""
        near = np.hypot(points[:, 0], points[:, 1]) < self._settings.max_range_m
        placed = deskew(points[near], fractions[near], motion)
        predicted = se2.compose(before, motion)
        match = self._register(placed, predicted)
        self._join(placed, predicted if match is None else match.pose)
        return match

    def _register(self, placed: NDArray[np.float64], predicted: se2.Array) -> PlacedScan | None:
        """Registers the points (N, 2) [m] of a scan on the map, beginning at a predicted pose (3,) [m, m, rad].

        Returns None if there is no map, or if hardly any map point is near the points.
        """
        reach, first_reach = self._registration.reach_m, _FIRST_REACH * self._registration.reach_m
        if self._map is None or not len(placed):
            return None
        target, surface = self._map
        source, scan = self._registration.make_cloud(placed, _SCAN_VOXEL * self._settings.voxel_size_m)
        if surface.count_matched(scan, predicted, first_reach) < FEWEST_MATCHED:
            return None
        pose = predicted
        for distance in (first_reach, reach):
            pose = self._registration.register(source, target, distance, pose)
        if surface.count_matched(scan, pose, reach) < FEWEST_MATCHED:
            return None
        near = surface.count_matched(scan, pose, self._settings.voxel_size_m) / len(scan)
        return PlacedScan(pose, partial(surface.compute_covariance, scan, pose, reach, reach**2), near)

    def _join(self, placed: NDArray[np.float64], pose: se2.Array) -> None:
        """Adds the points (N, 2) [m] of a scan at a pose (3,) to the map, unless the pose is near the last keyframe."""
        if self._last_keyframe is not None:
            moved = se2.between(self._last_keyframe, pose)
            near = np.hypot(moved[0], moved[1]) < _KEYFRAME_M
            if near and abs(se2.wrap(moved[2])) < _KEYFRAME_RAD:
                return
        if not len(placed):
            return
        self._keyframes.append(se2.transform(pose, placed))
        self._last_keyframe = pose
        voxel_size = self._settings.voxel_size_m
        cloud, points = self._registration.make_cloud(np.concatenate(self._keyframes), voxel_size)
        self._map = cloud, Surface(points, voxel_size)


def deskew(points: NDArray[np.float64], fractions: NDArray[np.float64], motion: se2.Array) -> NDArray[np.float64]:
    """Returns points (N, 2) [m] in the sensor's frame at the end of a scan, given the sensor's motion (3,) over the scan.

    Each given point is in the sensor's frame at the time of the point, a fraction (N,) of the scan: 0 is the scan's
    beginning, 1 its end.
    """
    poses = se2.exp(np.broadcast_to(se2.log(motion), (len(points), 3)), fractions - 1.0)
    return np.ascontiguousarray(se2.compose(poses, lift(points))[:, :2])
