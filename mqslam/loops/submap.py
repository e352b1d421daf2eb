"""Submaps: the returns of a few revolutions around one, rendered rigidly in its frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam import se2
from mqslam.config import Config
from mqslam.psi.place import PointSet
from mqslam.render import place_along
from mqslam.returns import Returns, Window


@dataclass(frozen=True, slots=True)
class Drive:
    """A run as loops are looked for in it.

    Args:
        windows: one per revolution.
        times: (N,) start of each [s].
        poses: (N, 3) at these times.
        travelled: (N,) length of the path so far [m].
    """

    windows: Sequence[Window]
    times: NDArray[np.float64]
    poses: se2.Array
    travelled: NDArray[np.float64]

    @classmethod
    def of(cls, windows: Sequence[Window], poses: se2.Array) -> Drive:
        """The drive of windows under poses (N, 3)."""
        steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
        return cls(windows, np.array([w.t0 for w in windows]), poses, np.concatenate([[0.0], np.cumsum(steps)]))

    def spaced(self, spacing_m: float) -> NDArray[np.int64]:
        """Indices of revolutions about spacing_m [m] of path apart."""
        marks = np.arange(0.0, self.travelled[-1] + 1e-9, spacing_m)
        return np.unique(np.searchsorted(self.travelled, marks))


def submap(drive: Drive, centre: int, reach_m: float, spacing_m: float, config: Config) -> PointSet:
    """Returns of the revolutions within reach_m of path around one, about spacing_m apart, in its frame.

    Args:
        centre: index of the revolution whose start pose is the frame.
    """
    marks = drive.travelled[centre] + np.arange(-reach_m, reach_m + 1e-9, spacing_m)
    chosen = np.unique(np.clip(np.searchsorted(drive.travelled, marks), 0, len(drive.windows) - 1))
    near = np.abs(drive.travelled[chosen] - drive.travelled[centre]) <= reach_m + spacing_m
    returns = Returns.concatenate([drive.windows[k].returns for k in chosen[near]])
    first, last = max(int(chosen[near][0]) - 1, 0), min(int(chosen[near][-1]) + 2, len(drive.times))
    local = se2.between(drive.poses[centre], drive.poses[first:last])
    return place_along(returns, drive.times[first:last], local, config)
