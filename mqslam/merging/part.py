"""A part of a merge: the keyframes and the graph of one result, as its files hold them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.backend.pose_graph import PoseGraph, pose_of
from mqslam.core import se2
from mqslam.core.keyframes import KeyframeMap
from mqslam.errors import DataError
from mqslam.factors.between import CAUCHY, HUBER, prior
from mqslam.formats.graphs.g2o import list_edges
from mqslam.formats.graphs.stored_graph import StoredGraph

_OFF_M: Final = 0.01  # by which poses of keyframes and graph may differ [m], which are the same numbers rounded
_REMEDY: Final = "give the folder of a result as `mqslam run` or `mqslam merge` has written it"


@dataclass(frozen=True, slots=True)
class Session:
    """One of the results that become one map.

    Args:
        folder: where it is.
        map: its keyframes and places.
        stamps_us: of all scans of each of its recordings (N,) [us].
        graph: its graph; the scans of its recordings are the first vertices, in order.
        frame: (3,) pose of the graph's frame in that of the keyframes.
    """

    folder: Path
    map: KeyframeMap
    stamps_us: tuple[NDArray[np.int64], ...]
    graph: StoredGraph
    frame: se2.Array

    @property
    def scans(self) -> int:
        """Number of scans of all its recordings."""
        return sum(len(stamps) for stamps in self.stamps_us)

    @property
    def poses(self) -> se2.Array:
        """Poses (V, 3) of all vertices, in the frame of the keyframes."""
        poses = np.array([pose_of(self.graph.values, key) for key in self.graph.keys])
        return se2.compose(self.frame, poses)


def make_part(folder: Path, kept: KeyframeMap, stamps_us: Sequence[NDArray[np.int64]], graph: StoredGraph) -> Session:
    """Makes a part of what the files of a result hold.

    Args:
        folder: the result, for messages.
        kept: its keyframes and places.
        stamps_us: of all scans of each of its recordings (N,) [us].
        graph: its graph.

    Raises:
        DataError: the files do not fit together.
    """
    keyframes, count = kept.keyframes, sum(len(stamps) for stamps in stamps_us)
    if not len(keyframes):
        raise DataError(folder, "holds a map without keyframes", "give a result of a recording that shows something")
    if len(stamps_us) != len(keyframes.recordings):
        problem = f"has {len(keyframes.recordings)} recordings in its keyframes and {len(stamps_us)} trajectories"
        raise DataError(folder, problem, _REMEDY)
    if graph.keys != tuple(range(len(graph.keys))) or len(graph.keys) < count:
        problem = f"holds {len(graph.keys)} poses, and its trajectories have {count} scans"
        raise DataError(folder / "graph.g2o", problem, _REMEDY)
    if not (keyframes.scans < count).all():
        raise DataError(folder / "keyframes", "names scans that graph.g2o does not have", _REMEDY)
    try:
        vertices = np.array([pose_of(graph.values, int(key)) for key in keyframes.scans])
    except RuntimeError as error:
        raise DataError(folder / "graph.g2o", "is no graph in the plane", _REMEDY) from error
    frame = se2.compose(keyframes.poses[0], se2.inverse(vertices[0]))
    off = se2.compose(frame, vertices) - keyframes.poses
    if np.hypot(off[:, 0], off[:, 1]).max() > _OFF_M:
        raise DataError(folder, "has keyframes that do not lie where its graph.g2o has them", _REMEDY)
    return Session(folder, kept, tuple(stamps_us), graph, frame)


def list_factors(part: Session, keys: Sequence[int]) -> list[gtsam.BetweenFactorPose2]:
    """Returns the edges of a part under other keys, with the losses that a run gives them, which its file lacks.

    Edges between scans that do not follow each other are loops; all others are motions.

    Args:
        part: the part.
        keys: (V,) key of each of its vertices.
    """
    ends = np.cumsum([len(stamps) for stamps in part.stamps_us])
    huber = gtsam.noiseModel.mEstimator.Huber.Create(HUBER)
    cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(CAUCHY)
    factors = []
    for edge in list_edges(part.graph.factors):
        a, b = edge.keys()
        motion = edge.measured()
        assert isinstance(motion, gtsam.Pose2)  # `make_part` has looked
        is_loop = max(a, b) < part.scans and (abs(a - b) > 1 or max(a, b) in ends)
        noise = gtsam.noiseModel.Robust.Create(cauchy if is_loop else huber, edge.noiseModel())
        factors.append(gtsam.BetweenFactorPose2(keys[a], keys[b], motion, noise))
    return factors


def build_alone(part: Session) -> PoseGraph:
    """Returns the graph of a part by itself, over the poses of its keyframes, held at its first pose."""
    keys = list(range(len(part.graph.keys)))
    factors, values, poses = gtsam.NonlinearFactorGraph(), gtsam.Values(), part.poses
    factors.push_back(prior(0, poses[0]))
    for factor in list_factors(part, keys):
        factors.push_back(factor)
    for key in keys:
        values.insert(key, gtsam.Pose2(*poses[key]))
    scans = part.map.keyframes.scans.tolist()
    return PoseGraph(factors, values, len(scans), scans.__getitem__)
