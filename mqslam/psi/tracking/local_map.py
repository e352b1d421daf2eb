"""Holds the running map, which consists of the rendered returns of the last keyframes, and the settings of matches to it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mqslam.core import se2
from mqslam.psi.minimiser import APART_BLUR, APART_SHARE, CORRELATION
from mqslam.psi.place import PointSet
from mqslam.psi.score import make_references

# A map with fewer keyframes than this takes new ones at shorter distances, because it is thin.
_GROWN_KEYFRAMES = 8


class Tuning(NamedTuple):
    """The settings for matching a track to its map.

    Args:
        keyframe_m: a scan joins the map if it is farther than this from the keyframe nearest in time [m]. A map of few
            keyframes takes scans at shorter distances.
        keyframe_rad: a scan also joins the map if its yaw differs by more than this from this keyframe's yaw [rad].
        keyframes: largest number of scans that the map holds.
        final_width: factor on the final widths s and beta_s where a scan is matched to the map, whose many keyframes scatter
            more than the scans of a window.
        first_step: first step of the annealing at which the match of a predicted scan begins. A prediction does not need the
            widths of step 0, which would pull scans back to where the map is denser.
        prediction_margin: least beta_s at which a match begins, in units of the error that is expected of its prediction.
        doubtful_psi: a match whose psi per return is more than this many times its usual value may be at a wrong minimum.
            Better matches are then looked for ahead of the match, behind the match, and rotated to either side.
        search_rad: least half width of the search for a scan in yaw [rad].
        correlation: number of returns that count as one independent measurement (`mqslam.psi.minimiser.CORRELATION`).
        sees_part: whether a scan shows only a part of the surroundings, so that a sensor that turns sees new objects.
        fades: whether neighbours that were seen less than a revolution before or after a return weigh less.
        apart_share: factor on the weight of a neighbour that was seen from a quite different direction.
        apart_blur: factor on the blur of such a neighbour.
    """

    keyframe_m: float = 4.0
    keyframe_rad: float = 0.1
    keyframes: int = 60
    final_width: float = 1.2
    first_step: int = 1
    prediction_margin: float = 1.0
    doubtful_psi: float = 1.15
    search_rad: float = 0.0
    correlation: float = CORRELATION
    sees_part: bool = False
    fades: bool = True
    apart_share: float = APART_SHARE
    apart_blur: float = APART_BLUR


USUAL = Tuning()
SURFACES = Tuning(
    keyframe_rad=0.35, final_width=1.0, search_rad=0.7, sees_part=True, fades=False, apart_share=1.0, apart_blur=1.0
)
"""The settings for a lidar, to which surfaces look the same from everywhere."""


@dataclass(frozen=True, slots=True)
class _Keyframe:
    """A scan that the map keeps: its start [s], its start pose (3,) [m, m, rad] and its points, in the map's frame."""

    t0: float
    pose: se2.Array
    placed: PointSet


class LocalMap:
    """The latest keyframes, in the order of time. Their poses stay fixed while scans are matched to their points.

    Args:
        tuning: states how many keyframes the map holds, and how far apart they are.
        chosen: starts [s] of the offered scans that the map keeps; None keeps scans that are far apart.

    Attributes:
        references: the points of all keyframes, as references of the score.
    """

    def __init__(self, tuning: Tuning, chosen: Collection[float] | None = None) -> None:
        self._tuning = tuning
        self._chosen = chosen
        self._keyframes: list[_Keyframe] = []
        self.references = make_references(_join([]))

    def __len__(self) -> int:
        """Number of keyframes that the map holds."""
        return len(self._keyframes)

    @property
    def times(self) -> list[float]:
        """Starts [s] of the keyframes, in order."""
        return [keyframe.t0 for keyframe in self._keyframes]

    def offer(self, t0: float, pose: se2.Array, placed: PointSet) -> None:
        """Keeps a rendered scan as a keyframe if its start is in `chosen`, the starts that were given to the map.

        If none were given, a scan is kept if it is far, in position or yaw, from the keyframe nearest in time. The first
        scan is always kept.

        Args:
            t0: start of the scan [s], earlier or later than all keyframes.
            pose: (3,) x, y [m], yaw [rad] of the sensor at t0, in the map's frame.
            placed: points of the scan in the map's frame.
        """
        if self._is_far(t0, pose) if self._chosen is None or not self._keyframes else t0 in self._chosen:
            self.add(t0, pose, placed)

    def add(self, t0: float, pose: se2.Array, placed: PointSet) -> None:
        """Keeps a rendered scan (arguments as in `offer`) as a keyframe; a full map drops its earliest keyframe."""
        kept = sorted([*self._keyframes, _Keyframe(t0, pose.copy(), placed)], key=lambda keyframe: keyframe.t0)
        self._keyframes = kept[-self._tuning.keyframes :]
        self.references = make_references(_join(self._keyframes))

    def _is_far(self, t0: float, pose: se2.Array) -> bool:
        """Returns whether a scan is far, in place or yaw, from the keyframe nearest in time; true if there is none."""
        if not self._keyframes:
            return True
        nearest = min(self._keyframes, key=lambda keyframe: abs(keyframe.t0 - t0))
        moved = se2.wrapped_between(nearest.pose, pose)
        young = min(1.0, len(self._keyframes) / _GROWN_KEYFRAMES)  # a map of few keyframes is thin
        far = np.hypot(moved[0], moved[1]) > young * self._tuning.keyframe_m
        return bool(far or abs(moved[2]) > self._tuning.keyframe_rad)


def _join(keyframes: list[_Keyframe]) -> PointSet:
    """Returns the points of all keyframes as one set, without jacobians, since a map does not move."""
    parts = [keyframe.placed for keyframe in keyframes]
    return PointSet(
        points=np.concatenate([np.empty((0, 2)), *(p.points for p in parts)]),
        jacobians=np.zeros((0, 2, 0)),
        covariances=np.concatenate([np.empty((0, 3)), *(p.covariances for p in parts)]),
        times=np.concatenate([np.empty(0), *(p.times for p in parts)]),
        rays=np.concatenate([np.empty((0, 2)), *(p.rays for p in parts)]),
    )
