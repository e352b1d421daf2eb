"""The small_gicp front end: generalized ICP matches each scan to the last keyframes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.errors import ConfigError
from mqslam.execution.extras import describe_missing
from mqslam.frontends.keyframe_matching import KeyframeMatcher
from mqslam.frontends.scan_matching import Matching, MatchingFrontEnd, from_matrix, lift, to_matrix

# Share of a scan's returns, and side of the map's voxels [m], with which the front end drifts least on its tuning drives.
STRONGEST, VOXEL_M = 0.5, 1.0
# Longest distance between corresponding points [m], chosen on the same drives.
_REACH_M = 1.0
# Most iterations of one registration.
_ITERATIONS = 30
# Number of nearest points, the point itself included, that show the direction of the surface at a point.
_NEIGHBOURS = 10
# Heights of the points that each return becomes, in units of the side of the voxels.
_HEIGHTS = (-0.5, 0.0, 0.5)


class SmallGicpFrontEnd(MatchingFrontEnd):
    """A front end that matches each scan to a map of the last keyframes with small_gicp.

    Args:
        context: settings, Doppler shift and odometry.

    Raises:
        ConfigError: small_gicp cannot be imported.
    """

    def __init__(self, context: Context) -> None:
        try:
            import small_gicp
        except ModuleNotFoundError as error:
            missing, remedy = describe_missing("small_gicp")
            raise ConfigError(f"front end small_gicp: {missing}", remedy) from error
        settings, registration = Matching.of(context, STRONGEST, VOXEL_M), _SmallGicpRegistration(small_gicp)
        super().__init__(context, settings.strongest, lambda: KeyframeMatcher(registration, settings))


class _SmallGicpRegistration:
    """small_gicp's generalized ICP of planar clouds (a `Registration`).

    Around each point, the library takes the direction in which neighbouring points spread least as the normal of the
    surface. For points in one plane, this direction is always the vertical, so that no surface in the plane would be found.
    Each return therefore becomes three points at different heights, like a piece of a wall. The heights are symmetric about
    the plane, so that scans stay in the plane.
    """

    reach_m = _REACH_M

    def __init__(self, small_gicp: Any) -> None:
        self._small_gicp = small_gicp

    def register(self, source: Any, target: Any, reach_m: float, begin: se2.Array) -> se2.Array:
        """Returns the pose (3,) [m, m, rad] of the cloud `source` in the frame of the cloud `target`; see `Registration`."""
        (cloud, _), (map_cloud, tree) = source, target
        result = self._small_gicp.align(
            map_cloud, cloud, tree, to_matrix(begin), max_correspondence_distance=reach_m, max_iterations=_ITERATIONS
        )
        return from_matrix(result.T_target_source)

    def make_cloud(self, points: NDArray[np.float64], voxel_size_m: float) -> tuple[Any, NDArray[np.float64]]:
        """Returns points (N, 2) [m] as a downsampled cloud with its search tree, and its points (M, 2) [m]."""
        planar = self._small_gicp.voxelgrid_sampling(lift(points), voxel_size_m).points()[:, :2]
        standing = np.concatenate([lift(planar) + np.array([0.0, 0.0, height * voxel_size_m]) for height in _HEIGHTS])
        cloud = self._small_gicp.PointCloud(standing)
        tree = self._small_gicp.KdTree(cloud)
        self._small_gicp.estimate_covariances(cloud, tree, _NEIGHBOURS)
        return (cloud, tree), planar
