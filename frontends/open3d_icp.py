"""The Open3D front end: the classical baseline, in which ICP matches each scan to the last keyframes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.errors import ConfigError
from mqslam.execution.extras import describe_missing
from mqslam.frontends.icp_covariance import Surface
from mqslam.frontends.keyframe_matching import KeyframeMatcher
from mqslam.frontends.scan_matching import Matching, MatchingFrontEnd, from_matrix, lift, to_matrix

# Share of a scan's returns, and side of the map's voxels [m], with which the front end drifts least on its tuning drives.
STRONGEST, VOXEL_M = 0.5, 1.0
# Longest distance between corresponding points [m], chosen on the same drives.
_REACH_M = 0.5
# Most iterations of one registration.
_ITERATIONS = 30
# Squared residual at which generalized ICP gives a pair a quarter of the weight [m^2].
_LOSS = 1.0


class Open3dIcpFrontEnd(MatchingFrontEnd):
    """A front end that matches each scan to a map of the last keyframes with Open3D.

    Args:
        context: settings, Doppler shift and odometry.

    Raises:
        ConfigError: Open3D cannot be imported.
    """

    def __init__(self, context: Context) -> None:
        settings = Matching.of(context, STRONGEST, VOXEL_M)
        is_generalized = context.config.open3d_icp.method == "generalized"
        registration = _Open3dRegistration(_import_open3d(), settings.voxel_size_m, is_generalized=is_generalized)
        super().__init__(context, settings.strongest, lambda: KeyframeMatcher(registration, settings))


class _Open3dRegistration:
    """Open3D's registration of planar clouds (a `Registration`).

    Open3D moves scans in six degrees of freedom. With point-to-point ICP, planar scans stay in their plane. Generalized
    ICP would divide by the variance of the scans in z, which is zero. The clouds for generalized ICP therefore get planar
    covariances with a unit variance in z, so that roll and pitch do not change.
    """

    reach_m = _REACH_M

    def __init__(self, open3d: Any, voxel_size_m: float, *, is_generalized: bool) -> None:
        self._open3d = open3d
        self._voxel_size_m = voxel_size_m
        self._is_generalized = is_generalized

    def register(self, source: Any, target: Any, reach_m: float, begin: se2.Array) -> se2.Array:
        """Returns the pose (3,) [m, m, rad] of the cloud `source` in the frame of the cloud `target`; see `Registration`."""
        registration = self._open3d.pipelines.registration
        criteria = registration.ICPConvergenceCriteria(max_iteration=_ITERATIONS)
        if self._is_generalized:
            estimation = registration.TransformationEstimationForGeneralizedICP(registration.GMLoss(_LOSS))
            register = registration.registration_generalized_icp
        else:
            estimation = registration.TransformationEstimationPointToPoint()
            register = registration.registration_icp
        result = register(source, target, reach_m, to_matrix(begin), estimation, criteria)
        return from_matrix(np.asarray(result.transformation))

    def make_cloud(self, points: NDArray[np.float64], voxel_size_m: float) -> tuple[Any, NDArray[np.float64]]:
        """Returns points (N, 2) [m] as a downsampled cloud with z = 0, and its points (M, 2) [m]; see `Registration`."""
        vectors = self._open3d.utility.Vector3dVector(lift(points))
        cloud = self._open3d.geometry.PointCloud(vectors).voxel_down_sample(voxel_size_m)
        planar = np.asarray(cloud.points)[:, :2]
        if self._is_generalized and len(planar):
            surface = Surface(planar, self._voxel_size_m)
            flatness, axes = surface.find_directions(surface.find_nearest(planar)[1])
            variances = np.stack([flatness, np.ones(len(flatness))], axis=1)
            covariances = np.tile(np.eye(3), (len(planar), 1, 1))
            covariances[:, :2, :2] = (axes * variances[:, None, :]) @ np.swapaxes(axes, 1, 2)
            cloud.covariances = self._open3d.utility.Matrix3dVector(covariances)
        return cloud, planar


def _import_open3d() -> Any:
    """Imports Open3D, which takes a second, and returns its module.

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
