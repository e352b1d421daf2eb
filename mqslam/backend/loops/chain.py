"""The chain: a trajectory with the graph that it optimises, which says how sure it is of two poses to each other.

It also says how wrongly it may lay out the scans of a submap around the one in whose frame the submap is.
Where the scans on either side of that one are wrong in its frame, the submap as a whole is off by the mean of these errors.
The score of two passes does not show it. It is little where the trajectory is sure of its motions, and where the errors of
both sides cancel. At the beginning of a recording, and where the vehicle stands while its yaw drifts, they do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.backend.linear.marginals import Uncertainty
from mqslam.backend.loops.submap import LATER_SHARE, SPACING_M, SUBMAP_M, Passes, pick_around
from mqslam.backend.pose_graph import PoseGraph
from mqslam.core import se2


class Relative(NamedTuple):
    """What the trajectory says about the pose of a scan in the frame of another.

    Args:
        motion: (3,) the pose.
        covariance: (3, 3) of the pose [m, m, rad].
    """

    motion: se2.Array
    covariance: NDArray[np.float64]


@dataclass(frozen=True)
class Chain:
    """A trajectory and how sure it is of itself.

    Args:
        drive: scans under the trajectory.
        graph: the graph that the trajectory optimises.
        values: the optimum.
    """

    drive: Passes
    graph: PoseGraph
    values: gtsam.Values

    def relate(self, pairs: Sequence[tuple[int, int]]) -> list[Relative]:
        """Returns what the trajectory says about pairs of scans, the second of each in the frame of the first.

        Raises:
            EstimationError: the covariances cannot be computed.
        """
        covariances = self._uncertainty.relate(pairs)
        poses = self.drive.poses
        return [Relative(se2.between(poses[a], poses[b]), c) for (a, b), c in zip(pairs, covariances, strict=True)]

    @cached_property
    def _uncertainty(self) -> Uncertainty:
        return Uncertainty(self.graph, self.values)


class SubmapLayout(NamedTuple):
    """What the layout of the two submaps of a pair leaves unsure.

    Args:
        earlier, later: covariances (3, 3) of the whole of either submap in its own frame [m, m, rad].
    """

    earlier: NDArray[np.float64]
    later: NDArray[np.float64]

    def widen(self, pose: se2.Array, covariance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns the covariance (3, 3) of a pose (3,) of the later frame in the earlier one, given that by the score."""
        turn = se2.adjoint(pose)
        return np.asarray(covariance + self.earlier + turn @ self.later @ turn.T)


def compute_layouts(chain: Chain, pairs: Sequence[tuple[int, int]]) -> list[SubmapLayout]:
    """Computes what the layout of submaps leaves unsure, for pairs of an earlier and a later scan.

    Args:
        chain: the trajectory that lays out the submaps.
        pairs: numbers of the scans in whose frames the submaps are.

    Raises:
        EstimationError: the uncertainty of the trajectory cannot be computed.
    """
    earlier = _compute_layouts(chain, [a for a, _ in pairs], SUBMAP_M)
    later = _compute_layouts(chain, [b for _, b in pairs], LATER_SHARE * SUBMAP_M)
    return [SubmapLayout(earlier[a], later[b]) for a, b in pairs]


def _compute_layouts(chain: Chain, centres: Sequence[int], reach_m: float) -> dict[int, NDArray[np.float64]]:
    """Returns by number of the scan the covariance (3, 3) of the submap around it.

    Each side counts by its share of the scans, and as if all of them were as wrong as the trajectory may be at the far end.
    """
    sides = []
    for centre in sorted(set(centres)):
        chosen = pick_around(chain.drive.travelled, centre, reach_m, SPACING_M)
        for end, count in ((chosen[0], np.sum(chosen < centre)), (chosen[-1], np.sum(chosen > centre))):
            sides.append((centre, int(end), float(count) / len(chosen)))
    layouts = {centre: np.zeros((3, 3)) for centre, _, _ in sides}
    relatives = chain.relate([(centre, end) for centre, end, _ in sides])
    for (centre, _, share), relative in zip(sides, relatives, strict=True):
        lever = share * se2.adjoint(relative.motion)
        layouts[centre] += lever @ relative.covariance @ lever.T
    return layouts
