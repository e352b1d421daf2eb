"""Builds the pose graph from measurements, odometry and other sensors; loops and the refinement's ties can be added.

Two kinds of ties occur. The argument `ties` holds the refinement's registrations of scans on earlier passes. `Submaps.ties`
connect the successive submaps into which the front end's map is divided.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import gtsam
import numpy as np
from gtsam.symbol_shorthand import M, X
from numpy.typing import NDArray

from mqslam.backend.marginals import Uncertainty
from mqslam.backend.pose_graph import Optimum, PoseGraph, build_pose_graph, optimise
from mqslam.backend.sensors.calibration import SensorEdges
from mqslam.backend.submaps import Submaps, split_into_submaps, widen_ties
from mqslam.core import se2
from mqslam.core.measurement import Loop, Measurement, Tie
from mqslam.errors import EstimationError
from mqslam.factors.between import loop_between, psi_between


class GraphProblem(ABC):
    """Base class of trajectories that can be optimised; the search for loops and the refinement call its methods."""

    @abstractmethod
    def build_graph(self, loops: Sequence[Loop], ties: Sequence[Tie] = ()) -> PoseGraph:
        """Returns the graph with the given loops and with the given ties of the refinement."""

    def optimise(
        self, loops: Sequence[Loop], ties: Sequence[Tie] = (), start: gtsam.Values | None = None
    ) -> tuple[PoseGraph, Optimum]:
        """Returns the graph with the given loops and ties, and its optimum.

        If the optimisation fails, the optimum has the starting values and the reason; `GivenGraph` raises an error instead.

        Args:
            loops: the loops of the graph.
            ties: the ties of the refinement in the graph.
            start: values of all variables from which the optimum is searched; None takes the graph's starting values. A
                search from the optimum of a graph with most of these loops takes half of the time.
        """
        graph = self.build_graph(loops, ties)
        return graph, optimise(graph, start)

    def solve_poses(self, loops: Sequence[Loop], ties: Sequence[Tie] = ()) -> se2.Array:
        """Returns the poses (N, 3) [m, m, rad] of the scans in the optimum that `optimise` returns."""
        graph, optimum = self.optimise(loops, ties)
        return graph.poses_at(optimum.values)

    def estimate_own_covariances(self) -> NDArray[np.float64]:
        """Estimates the covariance (N, 3, 3) of each scan's own pose error, without drift, in the scan's frame [m, m, rad].

        The estimate is half of the covariance of the scan's pose relative to a neighbouring scan, since both scans
        contribute errors. The neighbour is the scan before or the scan after, whichever gives the covariance with the
        smaller determinant: in a graph of submaps, the drift of the map lies only between scans of different submaps.

        Raises:
            EstimationError: the graph does not determine the covariances.
        """
        graph, optimum = self.optimise([])
        scans = range(graph.size)
        pairs = [*pairwise(scans), *((b, a) for a, b in pairwise(scans))]
        following, preceding = np.split(Uncertainty(graph, optimum.values).relate(pairs), 2)
        after, before = np.concatenate([following, following[-1:]]), np.concatenate([preceding[:1], preceding])
        after[-1], before[0] = before[-1], after[0]
        is_surer = np.linalg.det(after) <= np.linalg.det(before)
        return np.asarray(0.5 * np.where(is_surer[:, None, None], after, before))


@dataclass(frozen=True)
class Problem(GraphProblem):
    """A trajectory that is optimised from the measurements between its scans.

    Args:
        measurements: the front end's motions between successive scans.
        odometry: calibrated motions of the odometry between the same scans; empty if there is no odometry.
        sensors: edges of other sensors, by the names of the sensors.
        scale_sigma: standard deviation of the relative error that all distances of the radar have in common.
    """

    measurements: Sequence[Measurement]
    odometry: Sequence[Measurement]
    sensors: Mapping[str, SensorEdges] = field(default_factory=dict)
    scale_sigma: float = 0.0

    def build_graph(self, loops: Sequence[Loop], ties: Sequence[Tie] = ()) -> PoseGraph:
        """Returns the graph with the given loops and ties; its starting values are the chained measurements."""
        factors: list[gtsam.NonlinearFactor] = [*self.make_factors(X, M)]
        factors += [loop_between(X(loop.earlier), X(loop.later), loop) for loop in loops]
        factors += [psi_between(X(tie.earlier), X(tie.later), tie.pose, tie.covariance) for tie in ties]
        chain = se2.chain(m.pose for m in self.measurements)
        graph = build_pose_graph(chain, factors, chain[self.submaps.first_scans], self.scale_sigma)
        for edges in self.sensors.values():
            edges.add_to(graph, chain)
        return graph

    def make_factors(self, scan: Callable[[int], int], submap: Callable[[int], int]) -> list[gtsam.BetweenFactorPose2]:
        """Returns the factors of the front end and of the odometry, without loops and other sensors.

        The list holds, in this order, (1) a factor from its submap to each scan that was matched to a map, (2) the factors
        between successive submaps, (3) the front end's other motions between scans, and (4) the odometry's motions.

        Args:
            scan: returns the key of a scan, given its number.
            submap: returns the key of a submap, given its number.
        """
        ends: list[tuple[int, int, Tie | Measurement]] = []
        ends += [(submap(p.earlier), scan(p.later), p) for p in self.submaps.placements]
        ends += [(submap(t.earlier), submap(t.later), t) for t in self.submaps.ties]
        ends += [(scan(k), scan(k + 1), m) for k, m in [*self._list_apart(), *enumerate(self.odometry)]]
        return [psi_between(a, b, stated.pose, stated.covariance) for a, b, stated in ends]

    def list_statements(self) -> list[Measurement]:
        """Returns the motion that each factor of `make_factors` states, in the same order.

        If a factor starts or ends at a submap, its motion starts or ends at the submap's first scan. Its `apart` is NaN. All
        fields but `apart`, times, pose and covariance are copied from the front end's motion that ends at the same scan, or
        from the first motion if this scan is the drive's first.
        """
        submaps = self.submaps
        firsts = submaps.first_scans.tolist()
        spans = [(firsts[p.earlier], p.later, p) for p in submaps.placements]
        spans += [(firsts[t.earlier], firsts[t.later], t) for t in submaps.ties]
        starts = [*(m.t0 for m in self.measurements), *(m.t1 for m in self.measurements[-1:])]
        unknown = np.full(3, np.nan)
        stated = [
            replace(
                self.measurements[max(last - 1, 0)],
                t0=starts[first],
                t1=starts[last],
                pose=placed.pose,
                covariance=placed.covariance,
                apart=unknown,
            )
            for first, last, placed in spans
        ]
        return [*stated, *(m for _, m in self._list_apart()), *self.odometry]

    @cached_property
    def submaps(self) -> Submaps:
        """The submaps of the drive; the covariances of the ties between them are adapted to the drift that the run shows."""
        return widen_ties(split_into_submaps(self.measurements), self.measurements)

    @property
    def yaw_drift(self) -> float:
        """Random walk of the yaw of the front end's map [rad/sqrt(s)], by the ties between submaps; 0 without such ties."""
        lasts = self.measurements[-1].t1 - self.measurements[0].t0
        return float(np.sqrt(sum(tie.covariance[2, 2] for tie in self.submaps.ties) / lasts))

    def _list_apart(self) -> list[tuple[int, Measurement]]:
        """Returns the front end's motions that belong to no submap, as pairs (number of the motion's first scan, motion)."""
        return [(k, motion) for k, motion in enumerate(self.measurements) if not motion.on_map]


@dataclass(frozen=True)
class GivenGraph(GraphProblem):
    """A trajectory that is optimised by a given GTSAM graph of any factors.

    Args:
        factors: all factors except the factors of loops and ties; they must determine all variables.
        values: starting values of all variables.
        keys: (N,) key of the pose of each scan.
        lift: converts a factor between planar poses to a factor between poses of the graph.
    """

    factors: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    keys: Sequence[int]
    lift: Callable[[gtsam.BetweenFactorPose2], gtsam.NonlinearFactor]

    def build_graph(self, loops: Sequence[Loop], ties: Sequence[Tie] = ()) -> PoseGraph:
        """Returns the graph with the given loops and ties; its starting values are `values`."""
        factors = gtsam.NonlinearFactorGraph()
        given = [self.factors.at(k) for k in range(self.factors.size()) if self.factors.exists(k)]  # skips removed ones
        for factor in (*given, *self.make_loop_factors(loops), *self.make_tie_factors(ties)):
            factors.push_back(factor)
        return PoseGraph(factors, self.values, len(self.keys), self.keys.__getitem__)

    def make_loop_factors(self, loops: Sequence[Loop]) -> list[gtsam.NonlinearFactor]:
        """Returns one factor for each loop, between the poses of the graph that belong to the loop's scans."""
        return [self.lift(loop_between(self.keys[loop.earlier], self.keys[loop.later], loop)) for loop in loops]

    def make_tie_factors(self, ties: Sequence[Tie]) -> list[gtsam.NonlinearFactor]:
        """Returns one factor for each tie, between the poses of the graph that belong to the tie's scans."""
        keys = self.keys
        return [self.lift(psi_between(keys[tie.earlier], keys[tie.later], tie.pose, tie.covariance)) for tie in ties]

    def optimise(
        self, loops: Sequence[Loop], ties: Sequence[Tie] = (), start: gtsam.Values | None = None
    ) -> tuple[PoseGraph, Optimum]:
        """Returns the graph with the given loops and ties, and its optimum, searched from `start` if values are given.

        Raises:
            EstimationError: the graph cannot be optimised.
        """
        graph, optimum = super().optimise(loops, ties, start)
        if optimum.failure is not None:
            raise EstimationError(
                f"the graph could not be optimised ({optimum.failure})",
                "give values for all its variables, and factors that determine them, such as a prior on the first pose",
            )
        return graph, optimum
