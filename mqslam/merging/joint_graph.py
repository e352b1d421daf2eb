"""The joint graph of a merge: the edges of all parts in one graph, and links between their keyframes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.backend.given_graph import GivenGraph
from mqslam.config import Config
from mqslam.core import se2
from mqslam.factors.prior import prior
from mqslam.merging.part import Part, list_factors


@dataclass(frozen=True, slots=True)
class JointGraph:
    """The graph of all parts. Vertices are numbered from 0: those of all scans, part by part, and after them all others.

    Args:
        problem: the graph over the poses of all keyframes; links between them join it.
        scans: number of scans.
        vertices: number of vertices.
    """

    problem: GivenGraph
    scans: int
    vertices: int


def number_vertices(parts: Sequence[Part]) -> list[NDArray[np.int64]]:
    """Returns the numbers that the vertices of each part have in the joint graph."""
    scans = [part.scans for part in parts]
    others = [len(part.graph.keys) - part.scans for part in parts]
    first_scans = [0, *accumulate(scans)]
    first_others = [0, *accumulate(others)]
    return [
        np.concatenate([first_scans[n] + np.arange(scans[n]), first_scans[-1] + first_others[n] + np.arange(others[n])])
        for n in range(len(parts))
    ]


def join_graphs(parts: Sequence[Part], frames: Sequence[se2.Array], config: Config) -> JointGraph:
    """Joins the graphs of all parts; only the first pose of the first one is held.

    Args:
        parts: the parts.
        frames: (3,) pose of the frame of each part in that of the first one, from which the optimisation starts.
        config: all settings.
    """
    factors, values, keys = gtsam.NonlinearFactorGraph(), gtsam.Values(), list[int]()
    for part, frame, numbers in zip(parts, frames, number_vertices(parts), strict=True):
        poses = se2.compose(frame, part.poses)
        for key, pose in zip(numbers.tolist(), poses, strict=True):
            values.insert(key, gtsam.Pose2(*pose))
        if not keys:
            factors.push_back(prior(0, poses[0]))
        for factor in list_factors(part, numbers.tolist(), config):
            factors.push_back(factor)
        keys += numbers[part.map.keyframes.scans].tolist()
    problem = GivenGraph(factors, values, keys, lambda factor: factor, config.loops)
    return JointGraph(problem, sum(part.scans for part in parts), values.size())
