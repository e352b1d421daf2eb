"""Makes the sessions of a merge, and finds the relative poses of sessions from the places that they share.

A match is a loop between the map of an earlier session and a submap of a later session. A row is a list of matches of
successive submaps that agree with each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.backend.loops.chain import Chain, do_agree
from mqslam.backend.loops.recognition import PLACE_SPACING_M, PlaceDatabase, recognise
from mqslam.backend.pose_graph import pose_of, scale_values
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.keyframes import KeyframeMap
from mqslam.core.measurement import Loop
from mqslam.core.units import scale_pose
from mqslam.core.wording import count_of
from mqslam.errors import DataError, EstimationError
from mqslam.execution.runner import Runner
from mqslam.factors.between import CAUCHY, HUBER, scale_factors
from mqslam.formats.graphs.g2o import StoredGraph, list_edges
from mqslam.mapping.keyframing import pick_spaced
from mqslam.psi.place import Beam

_OFF_M: Final = 0.01  # largest distance [m] of a keyframe from its pose in the graph: only rounding may move it
GIVE_RESULT: Final = "give the folder of a result as `mqslam run` or `mqslam merge` has written it"


@dataclass(frozen=True, slots=True)
class Session:
    """One of the results that are merged, with its keyframes and its graph as read from its files.

    Args:
        folder: folder of the result.
        map: keyframes and places of the result.
        stamps_us: for each recording of the result, the stamps (N,) of all scans [us].
        graph: graph of the result; the scans of all recordings are the first vertices, in order.
        frame: (3,) pose of the graph's frame in the frame of the keyframes [m, m, rad].
    """

    folder: Path
    map: KeyframeMap
    stamps_us: tuple[NDArray[np.int64], ...]
    graph: StoredGraph
    frame: se2.Array

    @property
    def scans(self) -> int:
        """Number of scans of all recordings of the session."""
        return sum(len(stamps) for stamps in self.stamps_us)

    @property
    def poses(self) -> se2.Array:
        """Poses (V, 3) of all vertices of the graph, in the frame of the keyframes [m, m, rad]."""
        poses = np.array([pose_of(self.graph.values, key) for key in self.graph.keys])
        return se2.compose(self.frame, poses)


def scale_session(session: Session, factor: float, *, same_places: bool) -> Session:
    """Returns a session with all lengths multiplied by a factor.

    Args:
        session: the session, whose graph is planar.
        factor: factor on all lengths.
        same_places: whether the descriptors of the places stay valid at the new lengths; other descriptors are marked as
            outdated, so that they are made again when they are needed.
    """
    kept = session.map.scale(factor)
    if not same_places:
        kept = replace(kept, places=replace(kept.places, made_with={}))
    factors, values = scale_factors(session.graph.factors, factor), scale_values(session.graph.values, factor)
    graph = replace(session.graph, factors=factors, values=values)
    return replace(session, map=kept, graph=graph, frame=scale_pose(session.frame, factor))


def make_session(folder: Path, kept: KeyframeMap, stamps_us: Sequence[NDArray[np.int64]], graph: StoredGraph) -> Session:
    """Makes a session from the content of a result's files, and checks that these files fit together.

    Args:
        folder: folder of the result, for messages.
        kept: keyframes and places of the result.
        stamps_us: for each recording of the result, the stamps (N,) of all scans [us].
        graph: graph of the result.

    Raises:
        DataError: the files do not fit together.
    """
    keyframes, count = kept.keyframes, sum(len(stamps) for stamps in stamps_us)
    if not len(keyframes):
        raise DataError(folder, "holds a map without keyframes", "give a result whose map has keyframes")
    if len(stamps_us) != len(keyframes.recordings):
        problem = f"has {len(keyframes.recordings)} recordings in its keyframes and {len(stamps_us)} trajectories"
        raise DataError(folder, problem, GIVE_RESULT)
    if graph.keys != tuple(range(len(graph.keys))) or len(graph.keys) < count:
        problem = f"holds {len(graph.keys)} poses, which do not fit the {count} scans of the trajectories"
        raise DataError(folder / "graph.g2o", problem, GIVE_RESULT)
    if not (keyframes.scans < count).all():
        raise DataError(
            folder / "keyframes", "refers to scans that the trajectories of this result do not have", GIVE_RESULT
        )
    try:
        vertices = np.array([pose_of(graph.values, int(key)) for key in keyframes.scans])
    except RuntimeError as error:
        raise DataError(folder / "graph.g2o", "is not a graph of poses in the plane", GIVE_RESULT) from error
    frame = se2.compose(keyframes.poses[0], se2.inverse(vertices[0]))
    off = se2.compose(frame, vertices) - keyframes.poses
    if np.hypot(off[:, 0], off[:, 1]).max() > _OFF_M:
        raise DataError(folder, "has keyframes whose poses differ from the poses in its graph.g2o", GIVE_RESULT)
    return Session(folder, kept, tuple(stamps_us), graph, frame)


def list_factors(session: Session, keys: Sequence[int]) -> list[gtsam.BetweenFactorPose2]:
    """Returns the edges of a session's graph with new keys, and with the robust losses that its file does not store.

    Edges between scans that do not follow each other are loops; all other edges are motions.

    Args:
        session: the session.
        keys: (V,) new key of each vertex of the session's graph.
    """
    ends = np.cumsum([len(stamps) for stamps in session.stamps_us])
    huber = gtsam.noiseModel.mEstimator.Huber.Create(HUBER)
    cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(CAUCHY)
    factors = []
    for edge in list_edges(session.graph.factors):
        a, b = edge.keys()
        motion = edge.measured()
        assert isinstance(motion, gtsam.Pose2)  # `make_session` has checked it
        is_loop = max(a, b) < session.scans and (abs(a - b) > 1 or max(a, b) in ends)
        noise = gtsam.noiseModel.Robust.Create(cauchy if is_loop else huber, edge.noiseModel())
        factors.append(gtsam.BetweenFactorPose2(keys[a], keys[b], motion, noise))
    return factors


# Least number of matches of places that must agree on the relative pose of two sessions.
_FEWEST = 5
# The likeliest relative pose of two sessions needs at least this many times as many agreeing matches as any other relative
# pose. Otherwise several places fit, and the sessions are not linked.
_RIVAL = 2.0

Row = Sequence[Loop]


@dataclass(frozen=True, slots=True)
class Relation:
    """The relation of two sessions: matches of places that agree on the relative pose of the sessions.

    Args:
        matches: the matches that agree; empty if they are too few, or if another relative pose fits about as well.
        agreeing: number of matches that agree on the likeliest relative pose.
        rivals: number of matches that agree on the next likeliest relative pose, which contradicts the likeliest.
    """

    matches: list[Loop]
    agreeing: int
    rivals: int


def find_relation(rows: Sequence[Row], earlier: Chain, later: Chain) -> Relation:
    """Finds the matches that agree on the relative pose of two sessions, given both trajectories.

    Args:
        rows: rows of matches of submaps of the later session with places of the earlier session.
        earlier: the trajectory of the earlier session, optimised without the later session.
        later: the trajectory of the later session, optimised without the earlier session.

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
    """Finds a set of rows that all agree with each other and have a large sum of weights; a row is a list of matches.

    From each row a set is grown greedily: rows that agree with all rows of the set are added one by one.

    Args:
        agree: (N, N) whether two rows agree; every row agrees with itself.
        weights: (N,) weight of each row: the number of its matches.

    Returns:
        The sorted indices (M,) of the rows of the grown set with the largest sum of weights.
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
    """Returns for all pairs of rows (N, N) whether they agree.

    Two rows agree if the middle match of one row, carried along both trajectories, predicts the middle match of the other.
    """
    middles = [row[len(row) // 2] for row in rows]
    pairs = [(i, k) for i in range(len(rows)) for k in range(i + 1, len(rows))]
    before = earlier.relate([(middles[i].earlier, middles[k].earlier) for i, k in pairs])
    after = later.relate([(middles[i].later, middles[k].later) for i, k in pairs])
    agree = np.eye(len(rows), dtype=bool)
    for (i, k), one, other in zip(pairs, before, after, strict=True):
        agree[i, k] = agree[k, i] = do_agree(middles[i], middles[k], one, other)
    return agree


@dataclass(frozen=True, slots=True)
class Recognition:
    """The result of comparing submaps of a later session with places of an earlier session.

    Args:
        earlier, later: indices of the sessions.
        rows: number of rows of matches.
        matches: number of matches in these rows.
        ambiguous: number of submaps that match several places.
        compared: number of pairs of a submap and a place that psi has compared.
        relation: the matches that agree on the relative pose of the two sessions.
    """

    earlier: int
    later: int
    rows: int
    matches: int
    ambiguous: int
    compared: int
    relation: Relation


def introduce(
    sessions: Sequence[Session], chains: Sequence[Chain], estimator: EstimatorConfig, beam: Beam, runner: Runner
) -> list[Recognition]:
    """Recognises places of earlier sessions in later sessions, and returns the result for each pair of sessions.

    Args:
        sessions: the sessions.
        chains: each session's keyframes with its own graph at the optimum.
        estimator: settings of the score.
        beam: the sensor's measurement errors.
        runner: does the work.

    Raises:
        EstimationError: the uncertainty of a trajectory cannot be computed.
    """
    recognitions = []
    pairs = [(a, b) for b in range(len(sessions)) for a in range(b)]
    for a, b in runner.follow("recognise", pairs, len(pairs)):
        places, drive = sessions[a].map.places, chains[b].drive
        database = PlaceDatabase.of(chains[a].drive, places)
        queries = pick_spaced(drive.travelled, PLACE_SPACING_M)
        found = recognise(drive, queries, database, None, estimator, beam, runner.engine)
        relation = find_relation(found.rows, chains[a], chains[b])
        matches = sum(map(len, found.rows))
        recognitions.append(Recognition(a, b, len(found.rows), matches, len(found.ambiguous), found.compared, relation))
    return recognitions


def lay_out(
    sessions: Sequence[Session], chains: Sequence[Chain], recognitions: Sequence[Recognition]
) -> tuple[list[se2.Array], list[Loop]]:
    """Places all sessions in the frame of the first session, one after the other.

    The next session is always the one that has the most agreeing matches with a session that is already placed.

    Args:
        sessions: the sessions.
        chains: each session's keyframes with its own graph at the optimum.
        recognitions: the result of recognition for each pair of sessions.

    Returns:
        The pose (3,) of each session's frame in the frame of the first session [m, m, rad]; and the matches that were used,
        as links between keyframes, which are numbered through all sessions.

    Raises:
        EstimationError: no place that a session shares with the others is recognised with certainty.
    """
    firsts = np.cumsum([0, *(len(session.map.keyframes) for session in sessions)])
    frames: dict[int, se2.Array] = {0: np.zeros(3)}
    links = list[Loop]()
    while len(frames) < len(sessions):
        usable = [m for m in recognitions if m.relation.matches and (m.earlier in frames) != (m.later in frames)]
        if not usable:
            raise _explain(sessions, set(frames), recognitions)
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
    return [frames[n] for n in range(len(sessions))], links


def _find_middle(recognition: Recognition, lies: se2.Array, poses: se2.Array) -> int:
    """Returns the index of the match whose relative pose of the two sessions fits the keyframes of all matches best.

    Args:
        recognition: the recognition, with N matches that agree.
        lies: (N, 3) pose of the later session's frame in the earlier session's frame, from each match [m, m, rad].
        poses: (K, 3) poses of the later session's keyframes in the later session's frame [m, m, rad].
    """
    at = poses[[match.later for match in recognition.relation.matches]]
    where = np.array([se2.compose(lie, pose) for lie, pose in zip(lies, at, strict=True)])[:, :2]
    off = [np.median(np.hypot(*(se2.compose(lie, at)[:, :2] - where).T)) for lie in lies]
    return int(np.argmin(off))


def _explain(sessions: Sequence[Session], joined: set[int], recognitions: Sequence[Recognition]) -> EstimationError:
    """Returns an error that explains why sessions could not be joined to the sessions with the indices `joined`."""
    apart = [n for n in range(len(sessions)) if n not in joined]
    own = [m for m in recognitions if (m.earlier in joined) != (m.later in joined)]
    names = ", ".join(str(sessions[n].folder) for n in apart)
    ambiguous, matches = sum(m.ambiguous for m in own), sum(m.matches for m in own)
    rivals = max((m.relation.rivals for m in own), default=0)
    why = "none of its places is recognised in the others" if not matches else f"too few matches agree ({matches} found)"
    if ambiguous or rivals:
        fits = [f"{count_of(ambiguous, 'submap')} matched at several poses about equally well"] if ambiguous else []
        if rivals:
            agreeing = max(m.relation.agreeing for m in own)
            fits.append(f"{agreeing} matches agree on one relative pose and {rivals} on another")
        why = f"several places fit: {', and '.join(fits)}"
    return EstimationError(
        f"{names}: shares no place with the other recordings that is recognised with certainty; {why}",
        "give recordings that pass the same places",
    )
