"""Small pose graphs: chains with loops, and chains whose edges know some directions and not others."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from mqslam.backend.pose_graph import PoseGraph, build_pose_graph
from mqslam.core import se2
from mqslam.factors.between import psi_between

COVARIANCE = np.diag([0.01, 0.0025, 1e-4])
TURNS = np.tile([2.0, 0.1, 0.3], (30, 1))  # more than a full turn in all


def graph_of(motions: np.ndarray, initial: np.ndarray, loops: dict[tuple[int, int], np.ndarray] | None = None) -> PoseGraph:
    """Returns a graph of edges of one covariance, between successive poses and between those that loops join."""
    edges = {(k, k + 1): motion for k, motion in enumerate(motions)} | (loops or {})
    return build_pose_graph(
        initial,
        [psi_between(X(a), X(b), motion, COVARIANCE) for (a, b), motion in edges.items()],
    )


def unequal(count: int, lowest: float, highest: float, loops: int = 0, seed: int = 1) -> PoseGraph:
    """Returns a chain whose edges know some directions and not others: variances 10^lowest to 10^highest along any axes."""
    rng = np.random.default_rng(seed)
    motions = np.column_stack([rng.uniform(-1.0, 3.0, count), rng.normal(0.0, 0.1, count), rng.normal(0.0, 0.05, count)])
    poses = se2.chain(motions)

    def edge(a: int, b: int) -> gtsam.BetweenFactorPose2:
        axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        covariance = (axes * 10.0 ** rng.uniform(lowest, highest, 3)) @ axes.T
        noise = gtsam.noiseModel.Gaussian.Covariance(0.5 * (covariance + covariance.T))
        return gtsam.BetweenFactorPose2(X(a), X(b), gtsam.Pose2(*se2.between(poses[a], poses[b])), noise)

    edges = [edge(k, k + 1) for k in range(count)]
    return build_pose_graph(poses, edges + [edge(*sorted(rng.choice(count + 1, 2, replace=False))) for _ in range(loops)])
