"""Claims: how sure a trajectory is of where one of its poses lies against another."""

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


class Claims(Protocol):
    """How sure a trajectory is of its relative poses."""

    def relate(self, pairs: Sequence[tuple[int, int]]) -> NDArray[np.float64] | None:
        """Returns how sure it is of the second pose of each pair against the first.

        Args:
            pairs: numbers of K pairs of poses.

        Returns:
            (K, 3, 3) covariances in the frame of the second pose [m, m, rad]; None where they cannot be computed.
        """


@dataclass(frozen=True)
class GraphClaims:
    """The claims of a trajectory whose graph is known: exact.

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
        """Returns how sure the graph is of pairs of poses, as `Claims` says."""
        inside = [(self.numbers[a], self.numbers[b]) for a, b in pairs]
        try:
            covariances = Uncertainty(self.graph, self.values).relate(inside)
        except EstimationError:
            return None
        yaws = [float(self.poses[a, 2] - self.poses[b, 2]) for a, b in pairs]
        turned = [se2.rotate_covariance(c, yaw) for c, yaw in zip(covariances, yaws, strict=True)]
        return np.array(turned).reshape(-1, 3, 3)


@dataclass(frozen=True)
class MarginalClaims:
    """The claims of a trajectory of which only the covariance of every single pose is known: too large.

    What two poses have in common is not known then, and their errors are taken as independent. In truth both have grown
    from the same first pose, and their difference is smaller: a trajectory is never held to know more than it says.

    Args:
        covariances: (S, 3, 3) in the poses' own frames [m, m, rad].
        poses: (S, 3).
    """

    covariances: NDArray[np.float64]
    poses: se2.Array

    def relate(self, pairs: Sequence[tuple[int, int]]) -> NDArray[np.float64]:
        """Returns the largest covariances that the single poses leave, as `Claims` says."""
        related = []
        for a, b in pairs:
            lever = se2.adjoint(se2.between(self.poses[b], self.poses[a]))
            related.append(self.covariances[b] + lever @ self.covariances[a] @ lever.T)
        return np.array(related).reshape(-1, 3, 3)
