"""The pose graph: one pose per revolution, relative motions between them, optimised by GTSAM."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.factors.prior import prior


@dataclass(frozen=True)
class PoseGraph:
    """Factors over the poses x0 .. x(n-1) and the values they start from.

    Args:
        factors: the GTSAM graph, its prior on x0 included.
        initial: starting values.
        size: number of poses n.
    """

    factors: gtsam.NonlinearFactorGraph
    initial: gtsam.Values
    size: int


def pose_graph(initial: se2.Array, between: Iterable[gtsam.NonlinearFactor]) -> PoseGraph:
    """A graph of between-factors over poses (n, 3) that it starts from, the first of them held.

    Args:
        initial: (n, 3) poses to start from, x [m], y [m], yaw [rad].
        between: factors over keys X(0) .. X(n-1).
    """
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(initial):
        values.insert(X(k), gtsam.Pose2(*pose))
    factors.push_back(prior(X(0), initial[0]))
    for factor in between:
        factors.push_back(factor)
    return PoseGraph(factors, values, len(initial))


def optimise(graph: PoseGraph) -> gtsam.Values:
    """The values that minimise the graph's error, by Levenberg-Marquardt."""
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-9)
    parameters.setMaxIterations(100)
    return gtsam.LevenbergMarquardtOptimizer(graph.factors, graph.initial, parameters).optimize()


def poses_of(values: gtsam.Values, size: int) -> se2.Array:
    """Poses (n, 3) of values, yaw unwrapped along the way."""
    poses = np.array([(p.x(), p.y(), p.theta()) for p in (values.atPose2(X(k)) for k in range(size))])
    poses[:, 2] = np.unwrap(poses[:, 2])
    return poses


def marginals(graph: PoseGraph, values: gtsam.Values, indices: Sequence[int]) -> NDArray[np.float64]:
    """Covariances (len(indices), 3, 3) of poses in their own frames [m, m, rad], given all factors."""
    found = gtsam.Marginals(graph.factors, values)
    return np.array([found.marginalCovariance(X(k)) for k in indices])


def chain(motions: Iterable[se2.Array], start: se2.Array | None = None) -> se2.Array:
    """Poses (n + 1, 3) of n relative motions (3,) made one after the other."""
    poses = [np.zeros(3) if start is None else start]
    for motion in motions:
        poses.append(se2.compose(poses[-1], motion))
    return np.array(poses)
