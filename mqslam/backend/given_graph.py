"""A GTSAM graph that someone else has built over the poses of scans, which loops and ties join."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import gtsam

from mqslam.backend.pose_graph import Optimum, PoseGraph
from mqslam.backend.problem import GraphProblem
from mqslam.core.measurement import Loop
from mqslam.errors import EstimationError
from mqslam.factors.between import loop_between, psi_between


@dataclass(frozen=True)
class GivenGraph(GraphProblem):
    """A trajectory that is to be optimised, by a graph of any factors.

    Args:
        factors: all factors but those of loops; they determine all variables.
        values: of all variables.
        keys: (N,) key of the pose of each scan.
        lift: makes a factor between planar poses one between poses of the graph.
    """

    factors: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    keys: Sequence[int]
    lift: Callable[[gtsam.BetweenFactorPose2], gtsam.NonlinearFactor]

    def build_graph(self, loops: Sequence[Loop], ties: Sequence[Loop] = ()) -> PoseGraph:
        """Returns the graph with the given loops and ties of the refinement; it starts from the given values."""
        factors = gtsam.NonlinearFactorGraph()
        given = [self.factors.at(k) for k in range(self.factors.size()) if self.factors.exists(k)]  # removed ones leave gaps
        for factor in (*given, *self.make_loop_factors(loops), *self.make_tie_factors(ties)):
            factors.push_back(factor)
        return PoseGraph(factors, self.values, len(self.keys), self.keys.__getitem__)

    def make_loop_factors(self, loops: Sequence[Loop]) -> list[gtsam.NonlinearFactor]:
        """Returns the factors of loops."""
        return [self.lift(loop_between(self.keys[loop.earlier], self.keys[loop.later], loop)) for loop in loops]

    def make_tie_factors(self, ties: Sequence[Loop]) -> list[gtsam.NonlinearFactor]:
        """Returns the factors of ties of the refinement."""
        keys = self.keys
        return [self.lift(psi_between(keys[tie.earlier], keys[tie.later], tie.pose, tie.covariance)) for tie in ties]

    def optimise(self, loops: Sequence[Loop], ties: Sequence[Loop] = ()) -> tuple[PoseGraph, Optimum]:
        """Returns the graph with the given loops and ties, and its optimum.

        Raises:
            EstimationError: the graph cannot be optimised.
        """
        graph, optimum = super().optimise(loops, ties)
        if optimum.failure is not None:
            raise EstimationError(
                f"the graph could not be optimised ({optimum.failure})",
                "give values for all its variables, and factors that determine them, such as a prior on the first pose",
            )
        return graph, optimum
