"""The exact marginals of small pose graphs."""

from __future__ import annotations

from fractions import Fraction
from math import sqrt

import numpy as np

from mqslam.backend.pose_graph import PoseGraph


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
