"""The chain: a trajectory with the graph that it optimises, which says how sure it is of two poses to each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.backend.linear.marginals import Uncertainty
from mqslam.backend.loops.submap import Passes
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
