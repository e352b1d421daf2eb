"""Recognition between sessions: the places of each are searched in each other, which gives their relative pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.loops.chain import (
    LARGEST_CHI_SQUARE,
    Chain,
    as_relative,
    compose_relatives,
    compute_chi_square,
    invert_relative,
)
from mqslam.backend.loops.recognition import PLACE_SPACING_M, PlaceDatabase, recognise
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.measurement import Loop
from mqslam.errors import EstimationError
from mqslam.execution.runner import Runner
from mqslam.mapping.keyframing import pick_spaced
from mqslam.merging.part import Session
from mqslam.psi.place import Beam

# Least number of matches of places that must agree on how two recordings lie to each other.
_FEWEST = 5
# This many times as many matches must agree on how two recordings lie to each other as agree on any other way; otherwise
# several places fit, and nothing is linked.
_RIVAL = 2.0

Row = Sequence[Loop]


@dataclass(frozen=True, slots=True)
class Relation:
    """How two recordings lie to each other.

    Args:
        matches: those that agree; none where the recordings share no place, or where several relations fit.
        agreeing: number of matches that agree on the likeliest relation.
        rivals: number of matches that agree on the likeliest other one.
    """

    matches: list[Loop]
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
    before = earlier.relate([(middles[i].earlier, middles[k].earlier) for i, k in pairs])
    after = later.relate([(middles[i].later, middles[k].later) for i, k in pairs])
    said = [as_relative(match) for match in middles]
    agree = np.eye(len(rows), dtype=bool)
    for (i, k), one, other in zip(pairs, before, after, strict=True):
        expected = compose_relatives(compose_relatives(invert_relative(one), said[i]), other)
        agree[i, k] = agree[k, i] = compute_chi_square(expected, said[k]) <= LARGEST_CHI_SQUARE
    return agree


@dataclass(frozen=True, slots=True)
class Recognition:
    """What recognition says about two parts.

    Args:
        earlier, later: numbers of the parts.
        rows: number of rows of matches.
        matches: number of matches in them.
        ambiguous: number of submaps that match several places.
        compared: number of pairs that psi has compared.
        relation: how the two lie to each other.
    """

    earlier: int
    later: int
    rows: int
    matches: int
    ambiguous: int
    compared: int
    relation: Relation


def introduce(
    parts: Sequence[Session], chains: Sequence[Chain], estimator: EstimatorConfig, beam: Beam, runner: Runner
) -> list[Recognition]:
    """Looks each part up in every part before it."""
    recognitions = []
    pairs = [(a, b) for b in range(len(parts)) for a in range(b)]
    for a, b in runner.follow("recognise", pairs, len(pairs)):
        places, drive = parts[a].map.places, chains[b].drive
        database = PlaceDatabase.of(chains[a].drive, places)
        queries = pick_spaced(drive.travelled, PLACE_SPACING_M)
        found = recognise(drive, queries, database, None, estimator, beam, runner.engine)
        relation = find_relation(found.rows, chains[a], chains[b])
        matches = sum(map(len, found.rows))
        recognitions.append(Recognition(a, b, len(found.rows), matches, len(found.ambiguous), found.compared, relation))
    return recognitions


def lay_out(
    parts: Sequence[Session], chains: Sequence[Chain], recognitions: Sequence[Recognition]
) -> tuple[list[se2.Array], list[Loop]]:
    """Lays the parts on each other, at each step the one of which the most matches agree.

    Returns:
        the pose (3,) of the frame of each part in that of the first one, and links between keyframes of all parts.

    Raises:
        EstimationError: a part shares no place with the others.
    """
    firsts = np.cumsum([0, *(len(part.map.keyframes) for part in parts)])
    frames: dict[int, se2.Array] = {0: np.zeros(3)}
    links = list[Loop]()
    while len(frames) < len(parts):
        usable = [m for m in recognitions if m.relation.matches and (m.earlier in frames) != (m.later in frames)]
        if not usable:
            raise _explain(parts, set(frames), recognitions)
        best = max(usable, key=lambda m: m.relation.agreeing)
        a, b = best.earlier, best.later
        poses = chains[a].drive.poses, chains[b].drive.poses
        found = best.relation.matches
        at = np.array([se2.compose(poses[0][m.earlier], m.pose) for m in found])
        lies = se2.compose(at, se2.inverse(poses[1][[m.later for m in found]]))
        frame = lies[_find_middle(best, lies, poses[1])]
        if a in frames:
            frames[b] = se2.compose(frames[a], frame)
        else:
            frames[a] = se2.compose(frames[b], se2.inverse(frame))
        links += [
            Loop(int(firsts[a]) + m.earlier, int(firsts[b]) + m.later, m.pose, m.covariance, m.matched, m.psi) for m in found
        ]
    return [frames[n] for n in range(len(parts))], links


def _find_middle(recognition: Recognition, lies: se2.Array, poses: se2.Array) -> int:
    """Returns which of N relations (N, 3) leaves the matched keyframes nearest to where all matches have them."""
    at = poses[[match.later for match in recognition.relation.matches]]
    where = np.array([se2.compose(lie, pose) for lie, pose in zip(lies, at, strict=True)])[:, :2]
    off = [np.median(np.hypot(*(se2.compose(lie, at)[:, :2] - where).T)) for lie in lies]
    return int(np.argmin(off))


def _explain(parts: Sequence[Session], joined: set[int], recognitions: Sequence[Recognition]) -> EstimationError:
    """Returns the error that says why a part could not be joined."""
    apart = [n for n in range(len(parts)) if n not in joined]
    own = [m for m in recognitions if (m.earlier in joined) != (m.later in joined)]
    names = ", ".join(str(parts[n].folder) for n in apart)
    ambiguous, matches = sum(m.ambiguous for m in own), sum(m.matches for m in own)
    rivals = max((m.relation.rivals for m in own), default=0)
    why = "no place of it is recognised in the others" if not matches else f"only {matches} matches of places were found"
    if ambiguous or rivals:
        why = f"several places fit: {ambiguous} submaps match more than one place about as well"
        if rivals:
            agreeing = max(m.relation.agreeing for m in own)
            why += f", and {agreeing} matches agree on one relation and {rivals} on another"
    return EstimationError(
        f"{names}: shares no place with the other recordings that can be told for sure; {why}",
        "give recordings that pass through the same streets",
    )
