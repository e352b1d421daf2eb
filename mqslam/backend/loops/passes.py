"""Renders submaps from scans under a trajectory, and finds pairs of scans in which two passes may show the same place.

A submap holds the returns of some scans around a central scan. It has nothing to do with the submaps of the pose graph
(`backend.submaps`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.core import se2
from mqslam.core.keyframes import Keyframes
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.mapping.keyframing import pick_spaced, place_keyframes
from mqslam.mapping.render import place_along
from mqslam.psi.place import Beam, PointSet

# Path [m] between the scans of a submap, and between the scans for which earlier passes of the same place are searched.
SPACING_M = 5.0
# The submap of the earlier pass holds the returns of the scans within this path [m] to either side of its central scan.
SUBMAP_M = 15.0
# Length of the later pass's submap as a share of the earlier pass's, so that the later one lies within the earlier one.
LATER_SHARE = 0.5
_REACHES_M: Final = (SUBMAP_M, LATER_SHARE * SUBMAP_M)  # path to either side of the earlier and of the later submap [m]
# Points of a lidar's submap within this distance of a point show the surface on which it lies [m, in the recording's unit].
_AROUND_M = 1.0
# A point of a lidar's submap stands alone if fewer points than this, itself included, lie within _AROUND_M of it.
_FEW = 4
# Multiple of the spread along a surface that is added to a point's covariance.
_WIDENED = 30.0
_FAR_M: Final = 1e6  # added path [m] between two recordings: by definition longer than any real one


class Passes(Protocol):
    """Scans under a trajectory, from which submaps can be rendered."""

    @property
    def poses(self) -> se2.Array:
        """Poses (N, 3) of the scans in the trajectory's frame [m, m, rad]."""

    @property
    def travelled(self) -> NDArray[np.float64]:
        """Length (N,) of the path up to each scan [m]."""

    @property
    def shows_surfaces(self) -> bool:
        """Whether returns lie anywhere on surfaces, as a lidar's do; a radar's lie at the spots that reflect best."""

    def render(self, centre: int, chosen: NDArray[np.int64], beam: Beam) -> PointSet:
        """Renders the returns of the scans with the increasing numbers `chosen` (K,), in the frame of the scan `centre`."""

    def find_origins(self, centre: int, chosen: NDArray[np.int64]) -> NDArray[np.float64]:
        """Returns the sensor's positions (N, 2) [m] at the times of the points that `render` returns, in the same frame."""


@dataclass(frozen=True, slots=True)
class MappedDrive:
    """The keyframes of a map, as scans under a trajectory.

    Args:
        keyframes: keyframes of the map.
        poses: (K, 3) poses of the keyframes in the map's frame [m, m, rad].
        travelled: (K,) length of the path up to each keyframe [m]. Between two recordings it grows by more than any real
            path, so that keyframes of different recordings are never near each other on the path.
    """

    keyframes: Keyframes
    poses: se2.Array
    travelled: NDArray[np.float64]

    @classmethod
    def of(cls, keyframes: Keyframes, poses: se2.Array | None = None) -> MappedDrive:
        """Makes a drive from the keyframes of a map and their poses (K, 3) [m, m, rad]; None takes the poses in the map."""
        starts = np.flatnonzero(np.diff(keyframes.origins)) + 1
        jumps = np.zeros(len(keyframes))
        jumps[starts] = np.maximum(keyframes.travelled[starts - 1], 0.0) + _FAR_M
        return cls(keyframes, keyframes.poses if poses is None else poses, keyframes.travelled + np.cumsum(jumps))

    @property
    def shows_surfaces(self) -> bool:
        """Whether the keyframes are a lidar's."""
        return self.keyframes.unit_m is not None

    def render(self, centre: int, chosen: NDArray[np.int64], beam: Beam) -> PointSet:
        """Renders the returns of the keyframes with the numbers `chosen` (K,), in the frame of the keyframe `centre`."""
        return place_keyframes(self.keyframes, chosen, self.poses[centre], self.poses, beam)

    def find_origins(self, centre: int, chosen: NDArray[np.int64]) -> NDArray[np.float64]:
        """Returns the sensor's positions (N, 2) [m] at the times of the points that `render` returns, in the same frame."""
        poses = se2.between(self.poses[centre], self.poses[chosen])
        pairs = zip(poses, chosen.tolist(), strict=True)
        return np.concatenate([se2.transform(pose, self.keyframes.find_origins(k)) for pose, k in pairs])


@dataclass(frozen=True, slots=True)
class TrackedRun:
    """The scans of a run under a trajectory, in which loops are searched.

    Args:
        scans: scans of the recording.
        times: (N,) start of each scan [s] since the recording's start.
        poses: (N, 3) poses of the sensor at these times, in the trajectory's frame [m, m, rad].
        travelled: (N,) length of the path up to each scan [m].
        shows_surfaces: whether the scans are a lidar's.
    """

    scans: Sequence[Scan]
    times: NDArray[np.float64]
    poses: se2.Array
    travelled: NDArray[np.float64]
    shows_surfaces: bool = False

    @classmethod
    def of(cls, scans: Sequence[Scan], poses: se2.Array) -> TrackedRun:
        """Makes a run from N scans and the poses (N, 3) [m, m, rad] of the sensor at their starts."""
        times = scans.start_times if isinstance(scans, Scans) else np.array([scan.t0 for scan in scans])
        is_lidar = isinstance(scans, Scans) and scans.unit_m is not None
        return cls(scans, times, poses, se2.path_lengths(poses), is_lidar)

    def render(self, centre: int, chosen: NDArray[np.int64], beam: Beam) -> PointSet:
        """Renders the returns of the scans with the increasing numbers `chosen` (K,), in the frame of the scan `centre`."""
        returns = Returns.concatenate([self.scans[k].returns for k in chosen])
        return place_along(returns, *self._cut(centre, chosen), beam)

    def find_origins(self, centre: int, chosen: NDArray[np.int64]) -> NDArray[np.float64]:
        """Returns the sensor's positions (N, 2) [m] at the times of the points that `render` returns, in the same frame."""
        times = np.concatenate([self.scans[k].returns.times for k in chosen])
        return se2.find_poses_of_returns(*self._cut(centre, chosen), times)[:, :2]

    def _cut(self, centre: int, chosen: NDArray[np.int64]) -> tuple[NDArray[np.float64], se2.Array]:
        """Returns the start times (K,) [s] and poses (K, 3) of the scans around `chosen`, in the frame of the scan `centre`.

        They begin with the scan before the first chosen scan, and end with the scan after the last chosen scan.
        """
        first, last = max(int(chosen[0]) - 1, 0), min(int(chosen[-1]) + 2, len(self.times))
        return self.times[first:last], se2.between(self.poses[centre], self.poses[first:last])


def pick_around(travelled: NDArray[np.float64], centre: int, reach_m: float, spacing_m: float) -> NDArray[np.int64]:
    """Picks points of a path around one of its points, about `spacing_m` apart; returns their indices, increasing.

    Args:
        travelled: (N,) length of the path up to each point [m].
        centre: index of the point around which points are picked.
        reach_m: length of path to either side from which points are picked [m].
        spacing_m: path from one picked point to the next [m].
    """
    marks = travelled[centre] + np.arange(-reach_m, reach_m + 1e-9, spacing_m)  # rounding must not lose the last mark
    chosen = np.unique(np.clip(np.searchsorted(travelled, marks), 0, len(travelled) - 1))
    return np.asarray(chosen[np.abs(travelled[chosen] - travelled[centre]) <= reach_m + spacing_m])


def render_submap(drive: Passes, centre: int, reach_m: float, beam: Beam) -> PointSet:
    """Renders a submap: the returns of scans about SPACING_M apart around a central scan, in the central scan's frame.

    Args:
        drive: scans under a trajectory.
        centre: number of the central scan. Its pose at its start is the frame.
        reach_m: length of path to either side from which scans are taken [m].
        beam: the sensor's measurement errors.
    """
    return drive.render(centre, pick_around(drive.travelled, centre, reach_m, SPACING_M), beam)


def render_passes(earlier: tuple[Passes, int], later: tuple[Passes, int], beam: Beam) -> tuple[PointSet, PointSet]:
    """Renders the submaps of two passes; the later pass's submap is smaller, so that it lies within the earlier one.

    Args:
        earlier: the scans of the earlier pass, and the number of the central scan of its submap.
        later: the scans of the later pass, and the number of the central scan of its submap.
        beam: the sensor's measurement errors.

    Returns:
        The earlier and the later submap, each in the frame of its central scan. The points of a lidar are widened along the
        surfaces on which they lie, so that walls do not determine the relative position along them.
    """
    submaps = []
    for (drive, centre), reach_m in zip((earlier, later), _REACHES_M, strict=True):
        points = render_submap(drive, centre, reach_m, beam)
        submaps.append(widen_along_surfaces(points) if drive.shows_surfaces else points)
    return submaps[0], submaps[1]


def find_origins(drive: Passes, earlier: int, later: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns the sensor's positions (N, 2) [m] for the points of both submaps that `render_passes` renders of one drive."""
    centres = zip((earlier, later), _REACHES_M, strict=True)
    found = [drive.find_origins(c, pick_around(drive.travelled, c, reach_m, SPACING_M)) for c, reach_m in centres]
    return found[0], found[1]


def widen_along_surfaces(points: PointSet) -> PointSet:
    """Widens the covariance of each point of a submap along the surface on which the point lies.

    In every pass, the beams hit a wall at other spots, which are dense where the wall is near the sensor. Without widening,
    psi would pull two passes to where the dense parts of a wall cover each other. A widened point of a wall says where the
    wall is, but not where the pass is along the wall; ends of walls, doors and pillars show this. The spread along the
    surface is the larger eigenvalue of the scatter of the points around a point, minus the smaller eigenvalue.

    A point that stands alone is widened in every direction. Most such points are the few spots at which the beams of a scan
    hit a distant wall, and these spots lie elsewhere in every scan. A pillar or the end of a wall is hit again and again.

    Args:
        points: the points of the submap.
    """
    pairs = cKDTree(points.points).query_pairs(_AROUND_M, output_type="ndarray")
    one, other = np.concatenate([pairs, pairs[:, ::-1]]).T
    x, y = (points.points[other] - points.points[one]).T
    count = 1.0 + np.bincount(one, minlength=len(points))  # the point itself lies at the origin

    def average(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.bincount(one, values, minlength=len(points)) / count)

    mean_x, mean_y = average(x), average(y)
    xx, xy, yy = average(x * x) - mean_x**2, average(x * y) - mean_x * mean_y, average(y * y) - mean_y**2
    half = np.hypot(0.5 * (xx - yy), xy)  # half the difference of the two eigenvalues
    spread = np.column_stack([half + 0.5 * (xx - yy), xy, half - 0.5 * (xx - yy)])
    spread[count < _FEW] += [_AROUND_M**2, 0.0, _AROUND_M**2]
    return replace(points, covariances=points.covariances + _WIDENED * spread)


# Two scans with less path [m] than this between them belong to the same pass: the motions between them need no loop.
LEAST_PATH_M = 60.0
# Least share of the later pass's returns that must lie on the earlier pass.
MATCHED = 0.45


def find_passes(
    travelled: NDArray[np.float64],
    poses: se2.Array,
    spacing_m: float,
    least_path_m: float,
    reach_m: Callable[[NDArray[np.float64]], NDArray[np.float64]],
) -> list[list[tuple[int, int]]]:
    """Finds, for poses about `spacing_m` apart on a path, the nearest pose of each earlier pass of the same place.

    Args:
        travelled: (N,) length of the path up to each pose [m].
        poses: (N, 3) poses along the path [m, m, rad].
        spacing_m: path [m] between the poses that take part.
        least_path_m: two poses belong to different passes if the path [m] between them is longer than this.
        reach_m: returns the largest distance [m] between the two poses of a pair, given the path between them [m]; the
            distance must not decrease as the path grows.

    Returns:
        For each pose that takes part, in the order of the path, a list of pairs of indices (earlier, later) into all poses:
        one pair for each earlier pass, the nearest pass first. The list is empty without an earlier pass.
    """
    nodes = pick_spaced(travelled, spacing_m)
    travelled, xy = travelled[nodes], poses[nodes, :2]
    tree = cKDTree(xy)
    widest_m = float(reach_m(travelled[-1:])[0])
    passes = []
    for b, place in enumerate(xy):
        near = np.array(sorted(a for a in tree.query_ball_point(place, widest_m) if a < b), dtype=int)
        path = travelled[b] - travelled[near]
        apart = np.hypot(*(xy[near] - place).T)
        near = near[(path > least_path_m) & (apart <= reach_m(path))]
        ends = np.flatnonzero(np.diff(near) > least_path_m / spacing_m) + 1
        groups = np.split(near, ends) if len(near) else []  # each group is one earlier pass
        nearest = [group[np.argmin(np.hypot(*(xy[group] - place).T))] for group in groups]
        nearest.sort(key=lambda a: float(np.hypot(*(xy[a] - place))))
        passes.append([(int(nodes[a]), int(nodes[b])) for a in nearest])
    return passes
