"""The Open3D front end: the classical baseline, ICP of each scan to the last keyframes."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.config import Open3dIcpConfig
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement
from mqslam.core.scans import Scan
from mqslam.errors import ConfigError
from mqslam.frontends.icp_covariance import Surface
from mqslam.frontends.scan_matching import FEWEST, Match, in_space, matrix_of, motions, pose_of

INFLATION = 35.0  # variance of a pose over s^2 H^-1; makes mean NEES/3 one on kaist01, and 0.85 on kaist02
_FIRST_PASS = 3.0  # its reach over that of the last pass
_ITERATIONS = 30


class Open3dIcpFrontEnd:
    """Matches each revolution to a map of the last keyframes with Open3D, and starts as KISS-ICP's front end does.

    Raises:
        ConfigError: Open3D cannot be imported.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._open3d = _open3d()

    def measure(self, scans: Iterable[Scan]) -> Iterator[Measurement]:
        """The motion from the start of each window to the start of the next.

        Raises:
            EstimationError: fewer than two revolutions, or hardly any returns in the first ones.
        """
        settings = self._context.config.open3d_icp
        return motions(scans, lambda: _Open3dMatcher(self._open3d, settings), self._context, INFLATION)


class _Open3dMatcher:
    """Open3D's registration behind the protocol of `scan_matching`.

    It moves scans in six degrees of freedom. Point to point, scans in a plane stay in it. Generalized ICP would divide by
    the variance that points in a plane do not have; here it gets covariances that are planar but for a unit variance in z,
    which holds roll and pitch where they are.
    """

    reference = 1.0

    def __init__(self, open3d: Any, settings: Open3dIcpConfig) -> None:
        self._open3d = open3d
        self._settings = settings
        self._keyframes: deque[NDArray[np.float64]] = deque(maxlen=settings.keyframes)
        self._last_keyframe: se2.Array | None = None
        self._map: tuple[Any, Surface] | None = None

    def match(
        self, points: NDArray[np.float64], fractions: NDArray[np.float64], before: se2.Array, motion: se2.Array
    ) -> Match | None:
        near = np.hypot(points[:, 0], points[:, 1]) < self._settings.max_range_m
        placed = _deskewed(points[near], fractions[near], motion)
        predicted = se2.compose(before, motion)
        match = self._matched(placed, predicted)
        self._join(placed, predicted if match is None else match.pose)
        return match

    def _matched(self, placed: NDArray[np.float64], predicted: se2.Array) -> Match | None:
        reach = self._settings.reach_m
        if self._map is None:
            return None
        target, surface = self._map
        source = self._cloud(placed, 0.5 * self._settings.voxel_size_m)
        scan = np.asarray(source.points)[:, :2]
        if surface.matched(scan, predicted, _FIRST_PASS * reach) < FEWEST:
            return None
        pose = predicted
        for distance in (_FIRST_PASS * reach, reach):
            pose = pose_of(self._registered(source, target, distance, pose))
        matched = surface.matched(scan, pose, reach)
        if matched < FEWEST:
            return None
        return Match(pose, surface.covariance(scan, pose, reach, reach**2), matched / len(scan))

    def _registered(self, source: Any, target: Any, distance: float, begin: se2.Array) -> NDArray[np.float64]:
        """Where Open3D puts a scan, as a (4, 4) matrix."""
        registration = self._open3d.pipelines.registration
        criteria = registration.ICPConvergenceCriteria(max_iteration=_ITERATIONS)
        if self._settings.method == "generalized":
            estimation = registration.TransformationEstimationForGeneralizedICP(registration.GMLoss(1.0))
            register = registration.registration_generalized_icp
        else:
            estimation = registration.TransformationEstimationPointToPoint()
            register = registration.registration_icp
        found = register(source, target, distance, matrix_of(begin), estimation, criteria)
        return np.asarray(found.transformation)

    def _join(self, placed: NDArray[np.float64], pose: se2.Array) -> None:
        """Add a scan to the map, where the last keyframe is far behind."""
        if self._last_keyframe is not None:
            moved = se2.between(self._last_keyframe, pose)
            near = np.hypot(moved[0], moved[1]) < self._settings.keyframe_m
            if near and abs(se2.wrap(moved[2])) < self._settings.keyframe_rad:
                return
        if not len(placed):
            return
        self._keyframes.append(se2.transform(pose, placed))
        self._last_keyframe = pose
        cloud = self._cloud(np.concatenate(self._keyframes), self._settings.voxel_size_m)
        self._map = cloud, Surface(np.asarray(cloud.points)[:, :2])

    def _cloud(self, points: NDArray[np.float64], voxel_size: float) -> Any:
        """Points (N, 2) [m] as a downsampled cloud with z = 0, and covariances where the method needs them."""
        vectors = self._open3d.utility.Vector3dVector(in_space(points))
        cloud = self._open3d.geometry.PointCloud(vectors).voxel_down_sample(voxel_size)
        if self._settings.method == "generalized" and len(cloud.points):
            planar = np.asarray(cloud.points)[:, :2]
            flatness, axes = Surface(planar).directions(planar)
            variances = np.stack([flatness, np.ones(len(flatness))], axis=1)
            covariances = np.tile(np.eye(3), (len(planar), 1, 1))
            covariances[:, :2, :2] = (axes * variances[:, None, :]) @ np.swapaxes(axes, 1, 2)
            cloud.covariances = self._open3d.utility.Matrix3dVector(covariances)
        return cloud


def _deskewed(points: NDArray[np.float64], fractions: NDArray[np.float64], motion: se2.Array) -> NDArray[np.float64]:
    """Points (N, 2) [m] of their own times, as fractions (N,) of a scan's motion (3,), in the sensor's frame at its end."""
    poses = se2.exp(np.broadcast_to(se2.log(motion), (len(points), 3)), fractions - 1.0)
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = poses[:, 0] + c * points[:, 0] - s * points[:, 1]
    y = poses[:, 1] + s * points[:, 0] + c * points[:, 1]
    return np.stack([x, y], axis=1)


def _open3d() -> Any:
    """Open3D, which takes a second to import.

    Raises:
        ConfigError: it cannot be imported.
    """
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise ConfigError(
            f"front end open3d_icp: Open3D cannot be imported ({error}); it needs the system library libusb-1.0-0 "
            "(apt-get install libusb-1.0-0)"
        ) from error
    open3d.utility.set_max_threads(1)  # more add up in any order: the same windows shall give the same motions
    return open3d
