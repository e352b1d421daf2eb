"""Joins the parts of a merge: their edges in one graph, which links join, and their keyframes and places in one map."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.backend.given_graph import GivenGraph
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.keyframes import KEYFRAME_POINT, Keyframes, PlaceTable
from mqslam.core.stored import make_stored, release
from mqslam.factors.prior import prior
from mqslam.merging.part import Session, list_factors


def number_vertices(parts: Sequence[Session]) -> list[NDArray[np.int64]]:
    """Returns the numbers that the vertices of each part have in the joint graph."""
    scans = [part.scans for part in parts]
    others = [len(part.graph.keys) - part.scans for part in parts]
    first_scans = [0, *accumulate(scans)]
    first_others = [0, *accumulate(others)]
    return [
        np.concatenate([first_scans[n] + np.arange(scans[n]), first_scans[-1] + first_others[n] + np.arange(others[n])])
        for n in range(len(parts))
    ]


def join_graphs(parts: Sequence[Session], frames: Sequence[se2.Array], config: Config) -> GivenGraph:
    """Joins the graphs of all parts; only the first pose of the first one is held.

    Args:
        parts: the parts.
        frames: (3,) pose of the frame of each part in that of the first one, from which the optimisation starts.
        config: all settings.

    Returns:
        The graph over the poses of all keyframes. Vertices are numbered from 0: those of all scans, part by part, and after
        them all others.
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
    return GivenGraph(factors, values, keys, lambda factor: factor)


def join_keyframes(parts: Sequence[Session]) -> Keyframes:
    """Returns the keyframes of all parts, those of each still under its own poses.

    Their scans are numbered as the vertices of the joint graph. The first part says where the map lies on the Earth.
    """
    own = [part.map.keyframes for part in parts]
    firsts = np.cumsum([0, *(len(k.recordings) for k in own)])
    starts = np.cumsum([0, *(len(k.points) for k in own)])
    points = make_stored((int(starts[-1]),), KEYFRAME_POINT)
    for keyframes, start, end in zip(own, starts, starts[1:], strict=False):
        points[start:end] = keyframes.points
        release(points, keyframes.points)
    numbers = number_vertices(parts)
    return Keyframes(
        recordings=tuple(recording for k in own for recording in k.recordings),
        origins=np.concatenate([k.origins + first for k, first in zip(own, firsts, strict=False)]),
        scans=np.concatenate([n[k.scans] for k, n in zip(own, numbers, strict=True)]),
        stamps_us=np.concatenate([k.stamps_us for k in own]),
        poses=np.concatenate([k.poses for k in own]),
        covariances=np.concatenate([k.covariances for k in own]),
        travelled=np.concatenate([k.travelled for k in own]),
        rows=np.concatenate([k.rows + start for k, start in zip(own, starts, strict=False)]),
        points=points,
        georeference=own[0].georeference,
    )


def join_places(parts: Sequence[Session]) -> PlaceTable:
    """Returns the places of all parts, which have been described with the same settings."""
    firsts = np.cumsum([0, *(len(part.map.keyframes) for part in parts)])
    return PlaceTable(
        np.concatenate([part.map.places.keyframes + first for part, first in zip(parts, firsts, strict=False)]),
        np.concatenate([part.map.places.descriptors for part in parts]),
        parts[0].map.places.made_with,
    )
