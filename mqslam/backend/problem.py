"""What the pose graph is built from: measurements and odometry, which stay, and loops and their ties, which join later."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from gtsam.symbol_shorthand import M, X

from mqslam.backend.drift import widen_ties
from mqslam.backend.gnss.fix_use import FixEdges
from mqslam.backend.gyroscope.turn_edges import TurnEdges
from mqslam.backend.pose_graph import Optimum, PoseGraph, build_pose_graph, optimise, poses_of
from mqslam.backend.submaps import Submaps, split_into_submaps
from mqslam.config import GraphConfig, LoopConfig
from mqslam.core import se2
from mqslam.core.measurement import Loop, Measurement
from mqslam.factors.loop_between import loop_between
from mqslam.factors.odometry_between import odometry_between
from mqslam.factors.psi_between import psi_between


@dataclass(frozen=True)
class Problem:
    """A trajectory that is to be optimised.

    Args:
        measurements: the front end's motions between successive scans.
        odometry: the odometry's motions between the same scans, calibrated, or none.
        graph_settings: settings of the edges between successive scans.
        loop_settings: settings of the loops.
        turns: the turns of a gyroscope between the same scans, or None.
        fixes: positions of scans that a GNSS receiver has fixed, or None.
    """

    measurements: Sequence[Measurement]
    odometry: Sequence[Measurement]
    graph_settings: GraphConfig
    loop_settings: LoopConfig
    turns: TurnEdges | None = None
    fixes: FixEdges | None = None

    def build_graph(self, loops: Sequence[Loop], ties: Sequence[Loop] = ()) -> PoseGraph:
        """Returns the graph with the given loops and ties of the refinement; it starts from the chained measurements."""
        settings, submaps = self.graph_settings, self._submaps
        factors = [psi_between(M(p.submap), X(p.number), p.pose, p.covariance, settings) for p in submaps.placements]
        factors += [psi_between(M(t.submap), M(t.number), t.pose, t.covariance, settings) for t in submaps.ties]
        factors += [
            psi_between(X(k), X(k + 1), m.pose, m.covariance, settings)
            for k, m in enumerate(self.measurements)
            if not m.on_map
        ]
        factors += [odometry_between(X(k), X(k + 1), m, settings) for k, m in enumerate(self.odometry)]
        factors += [loop_between(X(loop.earlier), X(loop.later), loop, self.loop_settings) for loop in loops]
        factors += [psi_between(X(tie.earlier), X(tie.later), tie.pose, tie.covariance, settings) for tie in ties]
        chain = se2.chain(m.pose for m in self.measurements)
        if self.turns is not None:
            factors += self.turns.list_factors(chain)
        if self.fixes is not None:
            factors += self.fixes.list_factors()
        graph = build_pose_graph(chain, factors, settings, chain[submaps.first_scans])
        if self.turns is not None:
            self.turns.insert_into(graph.initial)
        if self.fixes is not None:
            self.fixes.insert_into(graph.initial)
        return graph

    @cached_property
    def _submaps(self) -> Submaps:
        """The submaps of the drive, tied to each other as surely as the run shows that its map drifts."""
        submaps = split_into_submaps(self.measurements, self.graph_settings)
        return widen_ties(submaps, self.measurements, self.graph_settings)

    @property
    def yaw_drift(self) -> float:
        """By how much the running map turns away in the root of a second [rad], as the ties of its submaps state it."""
        lasts = self.measurements[-1].t1 - self.measurements[0].t0
        return float(np.sqrt(sum(tie.covariance[2, 2] for tie in self._submaps.ties) / lasts))

    def optimise(self, loops: Sequence[Loop], ties: Sequence[Loop] = ()) -> tuple[PoseGraph, Optimum]:
        """Returns the graph with the given loops and ties, and its optimum."""
        graph = self.build_graph(loops, ties)
        return graph, optimise(graph)

    def solve_poses(self, loops: Sequence[Loop], ties: Sequence[Loop] = ()) -> se2.Array:
        """Returns the optimised poses (N, 3) with the given loops and ties [m, m, rad]."""
        graph, optimum = self.optimise(loops, ties)
        return poses_of(optimum.values, graph.size)
