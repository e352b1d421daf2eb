"""Pose graphs, and the exact marginals of small ones."""

from __future__ import annotations

from fractions import Fraction
from math import sqrt

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from mqslam.backend.pose_graph import PoseGraph, build_pose_graph
from mqslam.config import GraphConfig
from mqslam.core import se2


def make_unequal_graph(
    count: int, lowest: float, highest: float, loops: int = 0, seed: int = 1, config: GraphConfig | None = None
) -> PoseGraph:
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
    edges += [edge(*sorted(rng.choice(count + 1, 2, replace=False))) for _ in range(loops)]
    return build_pose_graph(poses, edges, config or GraphConfig())


def find_largest_error(graph: PoseGraph, covariances: np.ndarray) -> float:
    """Returns the largest error of marginals (n, 3, 3), per product of standard deviations, in exact arithmetic.

    It is infinite where the graph has no marginals, and it takes seconds for more than ten poses.
    """
    jacobian, _ = graph.factors.linearize(graph.initial).jacobian()
    if not np.isfinite(jacobian).all():
        return np.inf
    rows = [[Fraction(float(entry)) for entry in row] for row in jacobian]
    count = jacobian.shape[1]
    system = [
        [sum((row[i] * row[j] for row in rows if row[i] and row[j]), Fraction(0)) for j in range(count)]
        + [Fraction(i == j) for j in range(count)]
        for i in range(count)
    ]
    for i in range(count):  # Gauss and Jordan's method
        pivot = next((k for k in range(i, count) if system[k][i]), None)
        if pivot is None:
            return np.inf
        system[i], system[pivot] = system[pivot], system[i]
        system[i] = [entry / system[i][i] for entry in system[i]]
        for k in range(count):
            if k != i and system[k][i]:
                system[k] = [a - system[k][i] * b for a, b in zip(system[k], system[i], strict=True)]
    sigmas = [sqrt(system[i][count + i]) for i in range(count)]
    return max(
        abs(float(Fraction(float(block[i, j])) - system[3 * k + i][count + 3 * k + j]))
        / (sigmas[3 * k + i] * sigmas[3 * k + j])
        for k, block in enumerate(covariances)
        for i in range(3)
        for j in range(3)
    )
