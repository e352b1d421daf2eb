"""Submaps: the returns of a few scans around one, rendered rigidly in its frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.mapping.render import place_along
from mqslam.psi.place import Beam, PointSet


@dataclass(frozen=True, slots=True)
class Drive:
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
    def of(cls, scans: Sequence[Scan], poses: se2.Array) -> Drive:
        """Returns the drive of N scans under poses (N, 3)."""
        times = scans.start_times if isinstance(scans, Scans) else np.array([scan.t0 for scan in scans])
        return cls(scans, times, poses, se2.path_lengths(poses))


def pick_spaced(travelled: NDArray[np.float64], spacing_m: float) -> NDArray[np.int64]:
    """Returns indices about spacing_m [m] apart on a path: the first one past every mark along it.

    Args:
        travelled: (N,) length of the path so far [m].
        spacing_m: distance between marks [m].
    """
    marks = np.floor(travelled / spacing_m)  # number of marks passed so far, besides the one at the beginning
    return np.flatnonzero(np.diff(marks, prepend=-1.0) > 0.0)


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


def render_submap(drive: Drive, centre: int, reach_m: float, spacing_m: float, beam: Beam) -> PointSet:
    """Renders the returns of the scans around one, in its frame.

    Args:
        drive: scans under a trajectory.
        centre: index of the scan whose start pose is the frame.
        reach_m: length of path to either side from which scans are taken [m].
        spacing_m: path between these scans [m].
        beam: the sensor's errors.
    """
    chosen = pick_around(drive.travelled, centre, reach_m, spacing_m)
    returns = Returns.concatenate([drive.scans[k].returns for k in chosen])
    first, last = max(int(chosen[0]) - 1, 0), min(int(chosen[-1]) + 2, len(drive.times))
    local = se2.between(drive.poses[centre], drive.poses[first:last])
    return place_along(returns, drive.times[first:last], local, beam)
