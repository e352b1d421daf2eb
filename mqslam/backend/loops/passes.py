"""Passes of places: scans under a trajectory, the submaps that are rendered of them, and which scans may show one place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
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

# Path [m] between the scans of a submap, and between those for which an earlier pass of the same place is looked for.
SPACING_M = 5.0
# The submap of the earlier pass holds the returns within this path [m] to either side of a scan.
SUBMAP_M = 15.0
# The later pass's submap is this share of the earlier one's length, so that it lies within it.
LATER_SHARE = 0.5
_FAR_M: Final = 1e6  # by definition longer than any path that leads from one place to another


class Passes(Protocol):
    """Scans under a trajectory, of which submaps are rendered."""

    @property
    def poses(self) -> se2.Array:
        """The poses (N, 3)."""

    @property
    def travelled(self) -> NDArray[np.float64]:
        """Length of the path so far (N,) [m]."""

    def render(self, centre: int, chosen: NDArray[np.int64], beam: Beam) -> PointSet:
        """Renders the returns of some scans, in increasing order, in the frame of one."""


@dataclass(frozen=True, slots=True)
class MappedDrive:
    """The keyframes of a map as scans under a trajectory.

    Args:
        keyframes: of the map.
        poses: (K, 3) where they lie.
        travelled: (K,) length of the path so far [m]; another recording begins so far on that no path seems to lead to it.
    """

    keyframes: Keyframes
    poses: se2.Array
    travelled: NDArray[np.float64]

    @classmethod
    def of(cls, keyframes: Keyframes, poses: se2.Array | None = None) -> MappedDrive:
        """Returns the drive of a map, under poses (K, 3) other than its own if they are given."""
        starts = np.flatnonzero(np.diff(keyframes.origins)) + 1
        jumps = np.zeros(len(keyframes))
        jumps[starts] = np.maximum(keyframes.travelled[starts - 1], 0.0) + _FAR_M
        return cls(keyframes, keyframes.poses if poses is None else poses, keyframes.travelled + np.cumsum(jumps))

    def render(self, centre: int, chosen: NDArray[np.int64], beam: Beam) -> PointSet:
        """Renders the returns of some keyframes in the frame of one."""
        return place_keyframes(self.keyframes, chosen, self.poses[centre], self.poses, beam)


@dataclass(frozen=True, slots=True)
class TrackedRun:
    """A run as loops are looked for in it.

    Args:
        scans: of the recording.
        times: (N,) start of each [s].
        poses: (N, 3) at these times.
        travelled: (N,) length of the path so far [m].
    """

    scans: Sequence[Scan]
    times: NDArray[np.float64]
    poses: se2.Array
    travelled: NDArray[np.float64]

    @classmethod
    def of(cls, scans: Sequence[Scan], poses: se2.Array) -> TrackedRun:
        """Returns the drive of N scans under poses (N, 3)."""
        times = scans.start_times if isinstance(scans, Scans) else np.array([scan.t0 for scan in scans])
        return cls(scans, times, poses, se2.path_lengths(poses))

    def render(self, centre: int, chosen: NDArray[np.int64], beam: Beam) -> PointSet:
        """Renders the returns of some scans, in increasing order, in the frame of one."""
        returns = Returns.concatenate([self.scans[k].returns for k in chosen])
        first, last = max(int(chosen[0]) - 1, 0), min(int(chosen[-1]) + 2, len(self.times))
        local = se2.between(self.poses[centre], self.poses[first:last])
        return place_along(returns, self.times[first:last], local, beam)


def pick_around(travelled: NDArray[np.float64], centre: int, reach_m: float, spacing_m: float) -> NDArray[np.int64]:
    """Returns indices within about reach_m [m] of one on a path, about spacing_m [m] apart.

    Args:
        travelled: (N,) length of the path so far [m].
        centre: index of the middle.
        reach_m: length of path to either side [m].
        spacing_m: distance between the indices [m].
    """
    marks = travelled[centre] + np.arange(-reach_m, reach_m + 1e-9, spacing_m)  # rounding must not lose the last mark
    chosen = np.unique(np.clip(np.searchsorted(travelled, marks), 0, len(travelled) - 1))
    return np.asarray(chosen[np.abs(travelled[chosen] - travelled[centre]) <= reach_m + spacing_m])


def render_submap(drive: Passes, centre: int, reach_m: float, beam: Beam) -> PointSet:
    """Renders the returns of the scans around one, in its frame.

    Args:
        drive: scans under a trajectory.
        centre: index of the scan whose start pose is the frame.
        reach_m: length of path to either side from which scans are taken [m].
        beam: the sensor's errors.
    """
    return drive.render(centre, pick_around(drive.travelled, centre, reach_m, SPACING_M), beam)


def render_passes(earlier: tuple[Passes, int], later: tuple[Passes, int], beam: Beam) -> tuple[PointSet, PointSet]:
    """Renders the submaps of two passes, of which that of the later one is smaller, so that it lies within the other.

    Args:
        earlier: the scans of the earlier pass, and the number of the one in whose frame its submap is.
        later: the same of the later pass.
        beam: the sensor's errors.
    """
    return render_submap(*earlier, SUBMAP_M, beam), render_submap(*later, LATER_SHARE * SUBMAP_M, beam)


# Two scans with less path between them [m] are not two passes: odometry ties them already.
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
    """Finds, for poses a certain path apart, pairs (earlier, later) with the nearest pose of every earlier pass.

    Args:
        travelled: (N,) length of the path so far [m].
        poses: (N, 3).
        spacing_m: path [m] between the poses for which earlier passes are looked for.
        least_path_m: path [m] between two poses, from which on they are different passes.
        reach_m: returns how far apart two poses may lie [m], given the path between them [m]; it never falls.

    Returns:
        pairs of each later pose, the nearest pass first.
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
        groups = _split_passes(near[(path > least_path_m) & (apart <= reach_m(path))], least_path_m / spacing_m)
        nearest = [group[np.argmin(np.hypot(*(xy[group] - place).T))] for group in groups]
        nearest.sort(key=lambda a: float(np.hypot(*(xy[a] - place))))
        passes.append([(int(nodes[a]), int(nodes[b])) for a in nearest])
    return passes


def _split_passes(nodes: NDArray[np.int64], gap: float) -> list[NDArray[np.int64]]:
    """Splits increasing node indices where they jump by more than a gap: every part is one earlier pass."""
    if len(nodes) == 0:
        return []
    return list(np.split(nodes, np.flatnonzero(np.diff(nodes) > gap) + 1))
