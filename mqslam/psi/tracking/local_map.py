"""The running map: the returns of the last keyframes, where they were rendered."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.psi.place import PointSet
from mqslam.psi.scoring.references import make_references
from mqslam.psi.tracking.setup import Tuning

# A scan also joins the map after this much turning [rad].
_KEYFRAME_RAD = 0.1
# A map with fewer keyframes than this takes new ones at shorter distances, because it is thin.
_GROWN_KEYFRAMES = 8


@dataclass(frozen=True, slots=True)
class _Keyframe:
    """A scan that the map keeps: when it began [s], its start pose (3,) and its points."""

    t0: float
    pose: se2.Array
    placed: PointSet


class LocalMap:
    """A sliding window of keyframes in the order of time, held fixed while scans are matched to it.

    Args:
        tuning: how many keyframes it holds, and how far they are apart.
        chosen: starts [s] of the scans that it keeps of those that are offered; None keeps those that are far apart.
    """

    def __init__(self, tuning: Tuning, chosen: Collection[float] | None = None) -> None:
        self._tuning = tuning
        self._chosen = chosen
        self._keyframes: list[_Keyframe] = []
        self.references = make_references(_join([]))

    def __len__(self) -> int:
        """Number of keyframes that it holds."""
        return len(self._keyframes)

    @property
    def times(self) -> list[float]:
        """Starts of its keyframes [s], in order."""
        return [keyframe.t0 for keyframe in self._keyframes]

    def offer(self, t0: float, pose: se2.Array, placed: PointSet) -> None:
        """Keeps a rendered scan if it is far from the keyframe nearest in time, or was chosen to be kept.

        Args:
            t0: start of the scan [s], earlier or later than all keyframes.
            pose: (3,) its start pose.
            placed: its points.
        """
        if self._is_far(t0, pose) if self._chosen is None or not self._keyframes else t0 in self._chosen:
            self.add(t0, pose, placed)

    def add(self, t0: float, pose: se2.Array, placed: PointSet) -> None:
        """Keeps a rendered scan wherever it lies; the oldest one leaves when the map is full.

        Args:
            t0: start of the scan [s].
            pose: (3,) its start pose.
            placed: its points.
        """
        kept = sorted([*self._keyframes, _Keyframe(t0, pose.copy(), placed)], key=lambda keyframe: keyframe.t0)
        self._keyframes = kept[-self._tuning.keyframes :]
        self.references = make_references(_join([keyframe.placed for keyframe in self._keyframes]))

    def _is_far(self, t0: float, pose: se2.Array) -> bool:
        """Returns whether a scan is far from the keyframe nearest in time."""
        if not self._keyframes:
            return True
        nearest = min(self._keyframes, key=lambda keyframe: abs(keyframe.t0 - t0))
        moved = se2.wrapped_between(nearest.pose, pose)
        young = min(1.0, len(self._keyframes) / _GROWN_KEYFRAMES)  # a young map is thin: it takes keyframes sooner
        far = np.hypot(moved[0], moved[1]) > young * self._tuning.keyframe_m
        return bool(far or abs(moved[2]) > _KEYFRAME_RAD)


def _join(parts: list[PointSet]) -> PointSet:
    """Joins several point sets, without their jacobians: a map does not move."""

    def column(arrays: list[NDArray[np.float64]], *shape: int) -> NDArray[np.float64]:
        return np.concatenate([np.empty((0, *shape)), *arrays])

    return PointSet(
        points=column([p.points for p in parts], 2),
        jacobians=np.zeros((0, 2, 0)),
        covariances=column([p.covariances for p in parts], 3),
        times=column([p.times for p in parts]),
        rays=column([p.rays for p in parts], 2),
    )
