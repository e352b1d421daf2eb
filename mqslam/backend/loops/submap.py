"""Submaps: the returns of a few revolutions around one, rendered rigidly in its frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.scans import Returns, Scan
from mqslam.mapping.render import place_along
from mqslam.psi.place import Beam, PointSet


@dataclass(frozen=True, slots=True)
class Drive:
    """A run as loops are looked for in it.

    Args:
        scans: one per revolution.
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
        """The drive of windows under poses (N, 3)."""
        return cls(scans, np.array([w.t0 for w in scans]), poses, se2.path_lengths(poses))

    def spaced(self, spacing_m: float) -> NDArray[np.int64]:
        """Indices of revolutions about spacing_m [m] of path apart."""
        return spaced(self.travelled, spacing_m)


def spaced(travelled: NDArray[np.float64], spacing_m: float) -> NDArray[np.int64]:
    """Indices about spacing_m [m] apart on a path whose length so far is travelled (N,) [m]: the first past every mark."""
    marks = np.floor(travelled / spacing_m)  # passed so far, the one at the beginning aside
    return np.flatnonzero(np.diff(marks, prepend=-1.0) > 0.0)


def around(travelled: NDArray[np.float64], centre: int, reach_m: float, spacing_m: float) -> NDArray[np.int64]:
    """Indices within about reach_m [m] of one on such a path, about spacing_m [m] apart."""
    marks = travelled[centre] + np.arange(-reach_m, reach_m + 1e-9, spacing_m)
    chosen = np.unique(np.clip(np.searchsorted(travelled, marks), 0, len(travelled) - 1))
    return np.asarray(chosen[np.abs(travelled[chosen] - travelled[centre]) <= reach_m + spacing_m])


def submap(drive: Drive, centre: int, reach_m: float, spacing_m: float, beam: Beam) -> PointSet:
    """Returns of the revolutions within reach_m of path around one, about spacing_m apart, in its frame.

    Args:
        centre: index of the revolution whose start pose is the frame.
        beam: the sensor's errors.
    """
    chosen = around(drive.travelled, centre, reach_m, spacing_m)
    returns = Returns.concatenate([drive.scans[k].returns for k in chosen])
    first, last = max(int(chosen[0]) - 1, 0), min(int(chosen[-1]) + 2, len(drive.times))
    local = se2.between(drive.poses[centre], drive.poses[first:last])
    return place_along(returns, drive.times[first:last], local, beam)
