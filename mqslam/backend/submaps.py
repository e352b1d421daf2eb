"""Submaps: pieces of the running map, in which scans are measured.

A front end that matches scans to a running map errs in two ways. Each scan's place in the map is wrong on its own, and
such errors do not add up along the drive. The map itself drifts where it grows, and that does. The graph therefore holds
a pose for each piece of the map. Scans are tied to their piece with their own covariance, and each piece to the one
before it. A piece ends where the map takes its next keyframe, and that keyframe brings the error of its own scan into
the map: this is how far the next piece is off, as long as nothing more is known of how the map drifts (`drift`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.measurement import Measurement

# Path [m] along which scans are taken to be matched to the same map. After it the map has taken a keyframe more, and is off
# by as much as a scan may be.
_SUBMAP_M = 4.0
_LEAST = np.diag([1e-8, 1e-8, 1e-12])  # numerical: keeps the covariance of an error of zero from being singular


@dataclass(frozen=True, slots=True)
class Placement:
    """The pose of a scan, or of the next submap, in a submap.

    Args:
        submap: number of the submap.
        number: of the scan or of the next submap.
        pose: (3,) in the submap's frame [m, m, rad].
        covariance: (3, 3) of it, in the submap's frame.
    """

    submap: int
    number: int
    pose: se2.Array
    covariance: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Submaps:
    """All submaps of a drive, and what ties scans and submaps to each other.

    Args:
        first_scans: (J,) scan at whose start each submap has its frame.
        placements: of all scans that were measured in a map.
        ties: of submaps in the ones before them, where the same running map has led to both.
    """

    first_scans: NDArray[np.int64]
    placements: Sequence[Placement]
    ties: Sequence[Placement]


def split_into_submaps(measurements: Sequence[Measurement]) -> Submaps:
    """Splits a drive into submaps.

    Motions between scans that were not both matched to one map belong to no submap: they tie the scans themselves.

    Args:
        measurements: motions between successive scans.
    """
    errors = _estimate_errors(measurements)
    first_scans: list[int] = []
    placements: list[Placement] = []
    ties: list[Placement] = []
    within = np.zeros(3)  # pose of the scan in the last submap
    for k, covariance in enumerate(errors):
        if covariance is None:
            continue
        motion = measurements[k - 1] if k and measurements[k - 1].on_map else None
        if motion is not None:
            within = se2.compose(within, motion.pose)
        if motion is None or np.hypot(within[0], within[1]) >= _SUBMAP_M:
            if motion is not None:
                placed = se2.rotate_covariance(covariance, within[2])
                ties.append(Placement(len(first_scans) - 1, len(first_scans), within, placed))
            first_scans.append(k)
            within = np.zeros(3)
        placed = se2.rotate_covariance(covariance, within[2])
        placements.append(Placement(len(first_scans) - 1, k, within, placed))
    return Submaps(np.array(first_scans, dtype=np.int64), placements, ties)


def _estimate_errors(measurements: Sequence[Measurement]) -> list[NDArray[np.float64] | None]:
    """Estimates the covariance (3, 3) of each scan's place in the map, in its own frame; None where it was not matched.

    The covariance of a motion is that of both of its ends together, so that an end has half of it.
    """
    ends: list[list[NDArray[np.float64]]] = [[] for _ in range(len(measurements) + 1)]
    for k, motion in enumerate(measurements):
        if motion.on_map:
            half = 0.5 * motion.covariance
            ends[k].append(half)
            ends[k + 1].append(se2.rotate_covariance(half, -motion.pose[2]))
    return [np.mean(halves, axis=0) + _LEAST if halves else None for halves in ends]
