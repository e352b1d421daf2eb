"""Recognition of places: submaps are looked up in an index, and those that psi and their neighbours confirm are matches.

A single place may look like another one. Successive submaps that match successive places, all of them alike, hardly do so by
chance. They do where streets repeat; there a submap matches several places, and none of them is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mqslam.backend.loops.align import RIVAL
from mqslam.backend.loops.passes import MATCHED, is_unrivalled
from mqslam.backend.loops.search import align_passes, render_passes
from mqslam.backend.loops.submap import Passes
from mqslam.backend.recognition.place_index import PlaceIndex
from mqslam.backend.recognition.places import PLACE_SUBMAP_M, render_places
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.psi.correlate import compute_same_m
from mqslam.psi.place import Beam

# psi searches this far around the pose of a place that looks like a submap [m], [rad].
_SEARCH = (10.0, 0.1)
# Number of successive matches that must agree for a place to count as recognised: where streets look alike, single places
# do, too.
ROW = 3
# Longest path [m] between successive matches of a row.
_GAP_M = 25.0
# Distance [m] by which two matches may disagree, besides what their path adds.
_AGREE_M = 0.5
# Yaw [rad] by which two matches may disagree, besides what their path adds.
_AGREE_RAD = 0.03
# Share of the path between two matches by which they may disagree besides, as odometry errs.
_AGREE_SHARE = 0.1


class PlaceMatch(NamedTuple):
    """A submap laid on a place by psi.

    Args:
        query: number of the scan in whose frame the submap is, in its drive.
        place: number of the scan in whose frame the place is, in the map.
        pose: (3,) of the query in the frame of the place [m, m, rad].
        covariance: (3, 3) of the pose.
        matched: share of the submap's returns that lie on the place.
        psi: score per point.
        alone: whether the submap fits nowhere else as well around the place.
    """

    query: int
    place: int
    pose: se2.Array
    covariance: NDArray[np.float64]
    matched: float
    psi: float
    alone: bool


@dataclass(frozen=True, slots=True)
class Recognition:
    """What was recognised.

    Args:
        rows: rows of matches that agree, each along the drive.
        ambiguous: queries that match several places about as well.
        compared: number of pairs that psi has compared.
    """

    rows: list[list[PlaceMatch]]
    ambiguous: list[int]
    compared: int


@dataclass(frozen=True, slots=True)
class Ground:
    """Places that can be recognised.

    Args:
        drive: the scans that they are made of, where the map has them.
        places: (P,) number of the scan at each place.
        index: what they look like, in the same order.
    """

    drive: Passes
    places: NDArray[np.int64]
    index: PlaceIndex


class _Pair(NamedTuple):
    """A submap and a place that it may show.

    Args:
        query: number of the scan in its drive.
        place: number of the scan in the map.
        pose: (3,) of the query in the frame of the place, roughly.
    """

    query: int
    place: int
    pose: se2.Array


def recognise(
    drive: Passes,
    queries: NDArray[np.int64],
    ground: Ground,
    allowed: NDArray[np.bool_],
    estimator: EstimatorConfig,
    beam: Beam,
    engine: Engine,
) -> Recognition:
    """Finds the places that submaps of a drive show, without a guess of where they are.

    Args:
        drive: scans under a trajectory that is right over short ways.
        queries: (Q,) numbers of the scans around which submaps are looked up, in the order of the path.
        ground: the places.
        allowed: (Q, P) whether a place may be an answer to a query.
        estimator: settings of the score.
        beam: the sensor's errors.
        engine: where submaps are compared; the result does not depend on it.
    """
    if not len(queries) or not len(ground.places) or not allowed.any():
        return Recognition([], [], 0)
    rendered = render_places(drive, queries.tolist(), beam, engine)
    guesses = ground.index.look_up([submap.points for submap in rendered], allowed, _find_same(ground))
    pairs = [
        _Pair(int(query), int(ground.places[guess.place]), guess.pose)
        for query, listed in zip(queries, guesses, strict=True)
        for guess in listed
    ]
    pairs = _keep_supported(pairs, drive, ground.drive)
    laid = engine.map(_lay, (drive, ground.drive, estimator, beam), pairs)
    best, ambiguous = _choose([match for match in laid if match is not None], ground.drive, estimator)
    return Recognition(_find_rows(best, drive, ground.drive), ambiguous, len(pairs))


def _find_same(ground: Ground) -> list[NDArray[np.int64]]:
    """Returns for each place those that lie so near to it on the path that they show the same."""
    along = ground.drive.travelled[ground.places]
    order = np.argsort(along, kind="stable")
    firsts = np.searchsorted(along[order], along - PLACE_SUBMAP_M)
    ends = np.searchsorted(along[order], along + PLACE_SUBMAP_M, side="right")
    return [order[first:end] for first, end in zip(firsts, ends, strict=True)]


def _keep_supported(pairs: Sequence[_Pair], drive: Passes, ground: Passes) -> list[_Pair]:
    """Returns the pairs beside which another submap looks like the place where the pair has it."""
    found = np.array([se2.compose(ground.poses[pair.place], pair.pose) for pair in pairs]).reshape(-1, 3)
    queries = np.array([pair.query for pair in pairs], dtype=np.int64)
    i, k = _find_agreeing(queries, found, drive, _SEARCH)
    supported = np.zeros(len(pairs), dtype=bool)
    supported[i] = supported[k] = True
    return [pair for pair, keep in zip(pairs, supported, strict=True) if keep]


def _find_agreeing(
    queries: NDArray[np.int64],
    found: se2.Array,
    drive: Passes,
    slack: tuple[float, float],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Returns which of K queries, of two each, were found where the way between them leads from one to the other.

    Args:
        queries: (K,) numbers of the scans, which do not fall.
        found: (K, 3) where they were found, in the map's frame.
        drive: the scans.
        slack: by how much they may disagree [m], [rad], besides what the path between them adds.
    """
    along, poses = drive.travelled[queries], drive.poses[queries]
    ends = np.searchsorted(along, along + _GAP_M, side="right")
    i = np.repeat(np.arange(len(queries)), ends - np.arange(len(queries)))
    k = np.concatenate([np.arange(n, end) for n, end in enumerate(ends)]) if len(queries) else i
    apart = queries[i] != queries[k]
    i, k = i[apart], k[apart]
    expected = se2.compose(found[i], se2.between(poses[i], poses[k]))
    off = se2.wrapped_between(expected, found[k])
    path = along[k] - along[i]
    agree = np.hypot(off[:, 0], off[:, 1]) <= slack[0] + _AGREE_SHARE * path
    agree &= np.abs(off[:, 2]) <= slack[1]
    return i[agree], k[agree]


def _lay(shared: tuple[Passes, Passes, EstimatorConfig, Beam], pair: _Pair) -> PlaceMatch | None:
    """Lays a submap on a place by psi; returns None where it does not match or is not sure."""
    drive, ground, estimator, beam = shared
    submaps = render_passes((ground, pair.place), (drive, pair.query), beam)
    alignment = align_passes(*submaps, pair.pose, _SEARCH, estimator)
    if alignment is None:
        return None
    alone = is_unrivalled(alignment, MATCHED)
    return PlaceMatch(pair.query, pair.place, alignment.pose, alignment.covariance, alignment.matched, alignment.psi, alone)


def _choose(matches: Sequence[PlaceMatch], ground: Passes, estimator: EstimatorConfig) -> tuple[list[PlaceMatch], list[int]]:
    """Returns the best match of each query that fits nowhere else as well, and the queries that fit several places."""
    chosen, ambiguous = [], []
    for query in sorted({match.query for match in matches}):
        own = sorted((match for match in matches if match.query == query), key=lambda match: match.psi)
        best, found = own[0], [se2.compose(ground.poses[match.place], match.pose) for match in own]
        elsewhere = [
            other
            for other, pose in zip(own[1:], found[1:], strict=True)
            if np.hypot(*(pose - found[0])[:2]) > compute_same_m(estimator)
        ]
        if not best.alone or any(other.psi < RIVAL * best.psi for other in elsewhere):
            ambiguous.append(query)
        else:
            chosen.append(best)
    return chosen, ambiguous


def _find_rows(matches: Sequence[PlaceMatch], drive: Passes, ground: Passes) -> list[list[PlaceMatch]]:
    """Returns the matches, one per query, that stand in rows of enough that agree."""
    if not matches:
        return []
    queries = np.array([match.query for match in matches], dtype=np.int64)
    found = np.array([se2.compose(ground.poses[match.place], match.pose) for match in matches])
    i, k = _find_agreeing(queries, found, drive, (_AGREE_M, _AGREE_RAD))
    links = coo_array((np.ones(len(i), dtype=bool), (i, k)), shape=(len(matches), len(matches)))
    count, labels = connected_components(links, directed=False)
    rows = [[match for match, label in zip(matches, labels, strict=True) if label == n] for n in range(count)]
    return [row for row in rows if len(row) >= ROW]
