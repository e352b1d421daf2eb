"""The covariances that a trajectory states of its poses relative to each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.backend.linear.marginals import Uncertainty
from mqslam.backend.pose_graph import PoseGraph
from mqslam.core import se2
from mqslam.errors import EstimationError


class RelativeCovariances(Protocol):
    """The covariances of pairs of poses of a trajectory."""

    def relate(self, pairs: Sequence[tuple[int, int]]) -> NDArray[np.float64] | None:
        """Computes the covariance of the second pose of each pair relative to the first.

        Args:
            pairs: numbers of K pairs of poses.

        Returns:
            (K, 3, 3) covariances in the frame of the second pose [m, m, rad]; None where they cannot be computed.
        """


@dataclass(frozen=True)
class GraphCovariances:
    """The relative covariances of a trajectory whose graph is known: exact.

    Args:
        graph: the graph that the trajectory optimises.
        values: the optimum.
        numbers: (S,) number of each pose in the graph.
        poses: (S, 3).
    """

    graph: PoseGraph
    values: gtsam.Values
    numbers: Sequence[int]
    poses: se2.Array

    def relate(self, pairs: Sequence[tuple[int, int]]) -> NDArray[np.float64] | None:
        """Computes the covariances of pairs of poses by the graph, as `RelativeCovariances` says."""
        inside = [(self.numbers[a], self.numbers[b]) for a, b in pairs]
        try:
            covariances = Uncertainty(self.graph, self.values).relate(inside)
        except EstimationError:
            return None
        yaws = [float(self.poses[a, 2] - self.poses[b, 2]) for a, b in pairs]
        turned = [se2.rotate_covariance(c, yaw) for c, yaw in zip(covariances, yaws, strict=True)]
        return np.array(turned).reshape(-1, 3, 3)


@dataclass(frozen=True)
class SingleCovariances:
    """The relative covariances of a trajectory of which only the covariance of every single pose is known: too large.

    What two poses have in common is not known then, and their errors are taken as independent. In truth both have grown
    from the same first pose, and their difference is smaller: a trajectory is never held to know more than it says.

    Args:
        covariances: (S, 3, 3) in the poses' own frames [m, m, rad].
        poses: (S, 3).
    """

    covariances: NDArray[np.float64]
    poses: se2.Array

    def relate(self, pairs: Sequence[tuple[int, int]]) -> NDArray[np.float64]:
        """Computes the largest covariances that the single poses leave, as `RelativeCovariances` says."""
        related = []
        for a, b in pairs:
            lever = se2.adjoint(se2.between(self.poses[b], self.poses[a]))
            related.append(self.covariances[b] + lever @ self.covariances[a] @ lever.T)
        return np.array(related).reshape(-1, 3, 3)
