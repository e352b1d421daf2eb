"""The relation of two recordings: the rows of matching places that agree on how they lie to each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.loops.chain import Chain, Relative
from mqslam.backend.loops.consistency import (
    LARGEST_CHI_SQUARE,
    as_relative,
    compose_relatives,
    compute_chi_square,
    invert_relative,
)
from mqslam.backend.recognition.recognise import PlaceMatch
from mqslam.core.measurement import Loop

# Least number of matches of places that must agree on how two recordings lie to each other.
_FEWEST = 5
# This many times as many matches must agree on how two recordings lie to each other as agree on any other way; otherwise
# several places fit, and nothing is linked.
_RIVAL = 2.0

Row = Sequence[PlaceMatch]


@dataclass(frozen=True, slots=True)
class Relation:
    """How two recordings lie to each other.

    Args:
        matches: those that agree; none where the recordings share no place, or where several relations fit.
        agreeing: number of matches that agree on the likeliest relation.
        rivals: number of matches that agree on the likeliest other one.
    """

    matches: list[PlaceMatch]
    agreeing: int
    rivals: int


def find_relation(rows: Sequence[Row], earlier: Chain, later: Chain) -> Relation:
    """Finds the matches that agree, through both trajectories, on how two recordings lie to each other.

    Args:
        rows: rows of matches of the later recording in the earlier one.
        earlier: the trajectory of the one by itself.
        later: the trajectory of the other by itself.

    Raises:
        EstimationError: the uncertainty of a trajectory cannot be computed.
    """
    if not rows:
        return Relation([], 0, 0)
    agree = _compare_rows(rows, earlier, later)
    weights = np.array([len(row) for row in rows])
    best = find_heaviest(agree, weights)
    against = np.array([weights[best][~agree[n, best]].sum() > 0.5 * weights[best].sum() for n in range(len(rows))])
    others = np.flatnonzero(against)
    rival = others[find_heaviest(agree[np.ix_(others, others)], weights[others])]
    agreeing, rivals = int(weights[best].sum()), int(weights[rival].sum())
    accepted = agreeing >= _FEWEST and agreeing >= _RIVAL * rivals
    return Relation([match for n in best for match in rows[n]] if accepted else [], agreeing, rivals)


def find_heaviest(agree: NDArray[np.bool_], weights: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns the heaviest of the sets of rows that all agree with each other, each grown from one of the rows.

    Args:
        agree: (N, N) whether two rows agree; every row agrees with itself.
        weights: (N,) of the rows.
    """
    best: list[int] = []
    for first in range(len(weights)):
        support = agree[first] * weights
        chosen = agree[first].copy()
        members: list[int] = []
        for n in [first, *np.argsort(-(agree @ support), kind="stable").tolist()]:
            if chosen[n] and n not in members:
                members.append(n)
                chosen &= agree[n]
        if weights[members].sum() > weights[best].sum():
            best = members
    return np.array(sorted(best), dtype=np.int64)


def _compare_rows(rows: Sequence[Row], earlier: Chain, later: Chain) -> NDArray[np.bool_]:
    """Returns which rows (N, N) agree: whether the way over one and along both paths leads where the other does."""
    middles = [row[len(row) // 2] for row in rows]
    pairs = [(i, k) for i in range(len(rows)) for k in range(i + 1, len(rows))]
    before = earlier.relate([(middles[i].place, middles[k].place) for i, k in pairs])
    after = later.relate([(middles[i].query, middles[k].query) for i, k in pairs])
    said = [_as_relative(match) for match in middles]
    agree = np.eye(len(rows), dtype=bool)
    for (i, k), one, other in zip(pairs, before, after, strict=True):
        expected = compose_relatives(compose_relatives(invert_relative(one), said[i]), other)
        agree[i, k] = agree[k, i] = compute_chi_square(expected, said[k]) <= LARGEST_CHI_SQUARE
    return agree


def _as_relative(match: PlaceMatch) -> Relative:
    """Returns what a match says about the pose of the later keyframe in the frame of the earlier one."""
    return as_relative(Loop(match.place, match.query, match.pose, match.covariance, match.matched, match.psi))
