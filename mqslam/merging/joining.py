"""Joins the keyframes of several parts into those of one map."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mqslam.core.keyframes import KEYFRAME_POINT, Keyframes, PlaceTable
from mqslam.core.stored import make_stored, release
from mqslam.merging.joint_graph import number_vertices
from mqslam.merging.part import Part


def join_keyframes(parts: Sequence[Part]) -> Keyframes:
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


def join_places(parts: Sequence[Part]) -> PlaceTable:
    """Returns the places of all parts, which have been described with the same settings."""
    firsts = np.cumsum([0, *(len(part.map.keyframes) for part in parts)])
    return PlaceTable(
        np.concatenate([part.map.places.keyframes + first for part, first in zip(parts, firsts, strict=False)]),
        np.concatenate([part.map.places.descriptors for part in parts]),
        parts[0].map.places.made_with,
    )
