"""Meetings: each two parts are looked up in each other, and laid on each other where places are recognised."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mqslam.backend.loops.chain import Chain
from mqslam.backend.recognition.place_index import PlaceIndex
from mqslam.backend.recognition.places import PLACE_SPACING_M
from mqslam.backend.recognition.recognise import Ground, recognise
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.measurement import Loop
from mqslam.errors import EstimationError
from mqslam.execution.runner import Runner
from mqslam.mapping.keyframing import pick_spaced
from mqslam.merging.part import Part
from mqslam.merging.relation import Relation, find_relation
from mqslam.psi.place import Beam


@dataclass(frozen=True, slots=True)
class Meeting:
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
    parts: Sequence[Part], chains: Sequence[Chain], estimator: EstimatorConfig, beam: Beam, runner: Runner
) -> list[Meeting]:
    """Looks each part up in every part before it."""
    meetings = []
    pairs = [(a, b) for b in range(len(parts)) for a in range(b)]
    for a, b in runner.follow("recognise", pairs, len(pairs)):
        places, drive = parts[a].map.places, chains[b].drive
        ground = Ground(chains[a].drive, places.keyframes, PlaceIndex(places.descriptors))
        queries = pick_spaced(drive.travelled, PLACE_SPACING_M)
        allowed = np.ones((len(queries), len(places.keyframes)), dtype=bool)
        found = recognise(drive, queries, ground, allowed, estimator, beam, runner.engine)
        relation = find_relation(found.rows, chains[a], chains[b])
        matches = sum(map(len, found.rows))
        meetings.append(Meeting(a, b, len(found.rows), matches, len(found.ambiguous), found.compared, relation))
    return meetings


def lay_out(
    parts: Sequence[Part], chains: Sequence[Chain], meetings: Sequence[Meeting]
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
        usable = [m for m in meetings if m.relation.matches and (m.earlier in frames) != (m.later in frames)]
        if not usable:
            raise _explain(parts, set(frames), meetings)
        best = max(usable, key=lambda m: m.relation.agreeing)
        a, b = best.earlier, best.later
        poses = chains[a].drive.poses, chains[b].drive.poses
        found = best.relation.matches
        at = np.array([se2.compose(poses[0][m.place], m.pose) for m in found])
        lies = se2.compose(at, se2.inverse(poses[1][[m.query for m in found]]))
        frame = lies[_find_middle(best, lies, poses[1])]
        if a in frames:
            frames[b] = se2.compose(frames[a], frame)
        else:
            frames[a] = se2.compose(frames[b], se2.inverse(frame))
        links += [
            Loop(int(firsts[a]) + m.place, int(firsts[b]) + m.query, m.pose, m.covariance, m.matched, m.psi) for m in found
        ]
    return [frames[n] for n in range(len(parts))], links


def _find_middle(meeting: Meeting, lies: se2.Array, poses: se2.Array) -> int:
    """Returns which of N relations (N, 3) leaves the matched keyframes nearest to where all matches have them."""
    at = poses[[match.query for match in meeting.relation.matches]]
    where = np.array([se2.compose(lie, pose) for lie, pose in zip(lies, at, strict=True)])[:, :2]
    off = [np.median(np.hypot(*(se2.compose(lie, at)[:, :2] - where).T)) for lie in lies]
    return int(np.argmin(off))


def _explain(parts: Sequence[Part], joined: set[int], meetings: Sequence[Meeting]) -> EstimationError:
    """Returns the error that says why a part could not be joined."""
    apart = [n for n in range(len(parts)) if n not in joined]
    own = [m for m in meetings if (m.earlier in joined) != (m.later in joined)]
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
