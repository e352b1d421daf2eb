"""The Open3D front end: the classical baseline, in which ICP matches each scan to the last keyframes."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.config import Open3dIcpConfig
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement
from mqslam.core.scans import Scan
from mqslam.errors import ConfigError
from mqslam.execution.extras import describe_missing
from mqslam.frontends.icp_covariance import Surface
from mqslam.frontends.scan_matching import FEWEST_MATCHED, PlacedScan, from_matrix, lift, match_scans, to_matrix

# Longest distance between corresponding points [m]: the default side of the map's voxels.
_REACH_M = 1.0
# Number of scans that the map holds.
_KEYFRAMES = 20
# A scan joins the map when the sensor has travelled this far since the last keyframe [m].
_KEYFRAME_M = 2.0
# Most iterations of one registration.
_ITERATIONS = 30
# Squared residual at which generalized ICP gives a pair a quarter of the weight [m^2].
_LOSS = 1.0
# A scan also joins the map when the sensor has rotated by this much since the last keyframe [rad].
_KEYFRAME_RAD = 0.1
# Reach of the first registration of a scan, in units of _REACH_M, the reach of the second.
_FIRST_REACH = 3.0
# Side of a scan's voxels, as a share of the map's.
_SCAN_VOXEL = 0.5


class Open3dIcpFrontEnd:
    """Matches each scan to a map of the last keyframes with Open3D, and starts as KISS-ICP's front end does.

    Raises:
        ConfigError: Open3D cannot be imported.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._settings = context.config.open3d_icp
        self._open3d = _import_open3d()

    def measure(self, scans: Iterable[Scan]) -> Iterator[Measurement]:
        """Measures the motion from the start of each scan to the start of the next.

        Raises:
            EstimationError: there are fewer than two scans, or hardly any returns in the first ones.
        """
        return match_scans(scans, lambda: _Open3dMatcher(self._open3d, self._settings), self._context)


class _Open3dMatcher:
    """Open3D's registration as a `ScanMatcher`.

    Open3D moves scans in six degrees of freedom. With point-to-point ICP, planar scans stay in their plane. Generalized
    ICP would divide by their variance in z, which is zero. It is therefore given planar covariances with a unit variance
    in z, which keeps roll and pitch as they are.
    """

    reference = 1.0

    def __init__(self, open3d: Any, settings: Open3dIcpConfig) -> None:
        self._open3d = open3d
        self._settings = settings
        self._keyframes: deque[NDArray[np.float64]] = deque(maxlen=_KEYFRAMES)
        self._last_keyframe: se2.Array | None = None
        self._map: tuple[Any, Surface] | None = None

    def match(
        self, points: NDArray[np.float64], fractions: NDArray[np.float64], before: se2.Array, motion: se2.Array
    ) -> PlacedScan | None:
        """Matches a scan, and adds it to the map; see `ScanMatcher`."""
        near = np.hypot(points[:, 0], points[:, 1]) < self._settings.max_range_m
        placed = _deskew(points[near], fractions[near], motion)
        predicted = se2.compose(before, motion)
        match = self._register(placed, predicted)
        self._join(placed, predicted if match is None else match.pose)
        return match

    def _register(self, placed: NDArray[np.float64], predicted: se2.Array) -> PlacedScan | None:
        """Places a scan in the map, at first with a wide reach; returns None if hardly any of its points match."""
        reach, first_reach = _REACH_M, _FIRST_REACH * _REACH_M
        if self._map is None:
            return None
        target, surface = self._map
        source = self._cloud(placed, _SCAN_VOXEL * self._settings.voxel_size_m)
        scan = np.asarray(source.points)[:, :2]
        if surface.count_matched(scan, predicted, first_reach) < FEWEST_MATCHED:
            return None
        pose = predicted
        for distance in (first_reach, reach):
            pose = from_matrix(self._run_icp(source, target, distance, pose))
        matched = surface.count_matched(scan, pose, reach)
        if matched < FEWEST_MATCHED:
            return None
        return PlacedScan(pose, partial(surface.compute_covariance, scan, pose, reach, reach**2), matched / len(scan))

    def _run_icp(self, source: Any, target: Any, distance: float, begin: se2.Array) -> NDArray[np.float64]:
        """Registers a scan with Open3D from a start pose (3,), and returns the resulting pose as a (4, 4) matrix."""
        registration = self._open3d.pipelines.registration
        criteria = registration.ICPConvergenceCriteria(max_iteration=_ITERATIONS)
        if self._settings.method == "generalized":
            estimation = registration.TransformationEstimationForGeneralizedICP(registration.GMLoss(_LOSS))
            register = registration.registration_generalized_icp
        else:
            estimation = registration.TransformationEstimationPointToPoint()
            register = registration.registration_icp
        result = register(source, target, distance, to_matrix(begin), estimation, criteria)
        return np.asarray(result.transformation)

    def _join(self, placed: NDArray[np.float64], pose: se2.Array) -> None:
        """Adds a scan to the map if it is far from the last keyframe, or rotated relative to it."""
        if self._last_keyframe is not None:
            moved = se2.between(self._last_keyframe, pose)
            near = np.hypot(moved[0], moved[1]) < _KEYFRAME_M
            if near and abs(se2.wrap(moved[2])) < _KEYFRAME_RAD:
                return
        if not len(placed):
            return
        self._keyframes.append(se2.transform(pose, placed))
        self._last_keyframe = pose
        cloud = self._cloud(np.concatenate(self._keyframes), self._settings.voxel_size_m)
        self._map = cloud, Surface(np.asarray(cloud.points)[:, :2], self._settings.voxel_size_m)

    def _cloud(self, points: NDArray[np.float64], voxel_size: float) -> Any:
        """Returns points (N, 2) [m] as a downsampled cloud with z = 0, with covariances if the method needs them."""
        vectors = self._open3d.utility.Vector3dVector(lift(points))
        cloud = self._open3d.geometry.PointCloud(vectors).voxel_down_sample(voxel_size)
        if self._settings.method == "generalized" and len(cloud.points):
            planar = np.asarray(cloud.points)[:, :2]
            surface = Surface(planar, self._settings.voxel_size_m)
            flatness, axes = surface.find_directions(surface.find_nearest(planar)[1])
            variances = np.stack([flatness, np.ones(len(flatness))], axis=1)
            covariances = np.tile(np.eye(3), (len(planar), 1, 1))
            covariances[:, :2, :2] = (axes * variances[:, None, :]) @ np.swapaxes(axes, 1, 2)
            cloud.covariances = self._open3d.utility.Matrix3dVector(covariances)
        return cloud


def _deskew(points: NDArray[np.float64], fractions: NDArray[np.float64], motion: se2.Array) -> NDArray[np.float64]:
    """Moves points (N, 2) [m] to the sensor's frame at the end of a scan, given the sensor's motion (3,) over the scan.

    Each point is in the sensor's frame at its own time, a fraction (N,) of the scan from 0 at its beginning to 1 at its end.
    """
    poses = se2.exp(np.broadcast_to(se2.log(motion), (len(points), 3)), fractions - 1.0)
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = poses[:, 0] + c * points[:, 0] - s * points[:, 1]
    y = poses[:, 1] + s * points[:, 0] + c * points[:, 1]
    return np.stack([x, y], axis=1)


def _import_open3d() -> Any:
    """Imports Open3D, which takes a second.

    Raises:
        ConfigError: Open3D cannot be imported.
    """
    try:
        import open3d
    except ModuleNotFoundError as error:
        missing, remedy = describe_missing("open3d")
        raise ConfigError(f"front end open3d_icp: {missing}", remedy) from error
    except (ImportError, OSError) as error:  # Open3D is installed, but a system library that it loads is not
        raise ConfigError(
            f"front end open3d_icp: Open3D cannot be imported ({error}); it needs the system library libusb-1.0-0 "
            "(apt-get install libusb-1.0-0)"
        ) from error
    open3d.utility.set_max_threads(1)  # the same scans must give the same motions, but several threads add up in any order
    return open3d
