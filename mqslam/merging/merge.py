"""Merges sessions into one map: finds the places that they share, links them, optimises one graph, and finds changes.

results -> places recognised -> relations -> joint graph -> links -> one trajectory per recording -> one map -> changes
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import accumulate
from operator import add

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.backend.loops.chain import Chain, Relative, as_relative, compute_chi_square
from mqslam.backend.loops.closing import LoopCloser, score_loop
from mqslam.backend.loops.passes import MappedDrive
from mqslam.backend.loops.recognition import describe_map
from mqslam.backend.marginals import compute_all_marginals
from mqslam.backend.pose_graph import PoseGraph, optimise, poses_of, scale_graph, scale_values
from mqslam.backend.problem import GivenGraph
from mqslam.config import Config, EstimatorConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.keyframes import KEYFRAME_POINT, KeyframeMap, Keyframes, MappedRecording, PlaceTable
from mqslam.core.measurement import Loop, LoopSearch
from mqslam.core.point_map import PointMap
from mqslam.core.stored import make_stored, release
from mqslam.core.trajectory import Trajectory
from mqslam.core.units import scale_settings, scale_tie, scale_track
from mqslam.errors import EstimationError
from mqslam.execution.runner import Runner
from mqslam.factors.between import prior
from mqslam.mapping.keyframing import place_points
from mqslam.mapping.render import score_points
from mqslam.merging.changes import Change, find_changes, measure_relative_uncertainty
from mqslam.merging.sessions import Recognition, Session, introduce, lay_out, list_factors, scale_session
from mqslam.psi.place import Beam, PointSet, beam_of, compute_beam_covariance


def number_vertices(sessions: Sequence[Session]) -> list[NDArray[np.int64]]:
    """Returns for each session the numbers (V,) that its vertices have in the joint graph."""
    scans = [session.scans for session in sessions]
    others = [len(session.graph.keys) - session.scans for session in sessions]
    first_scans = [0, *accumulate(scans)]
    first_others = [0, *accumulate(others)]
    return [
        np.concatenate([first_scans[n] + np.arange(scans[n]), first_scans[-1] + first_others[n] + np.arange(others[n])])
        for n in range(len(sessions))
    ]


def join_graphs(sessions: Sequence[Session], frames: Sequence[se2.Array]) -> GivenGraph:
    """Joins the graphs of all sessions; only the first pose of the first session is held fixed.

    Args:
        sessions: the sessions.
        frames: for each session, the initial pose (3,) of its frame in the frame of the first session [m, m, rad].

    Returns:
        The graph over the poses of all keyframes. Vertices are numbered from 0: first all scans, session by session, and
        after them all other vertices.
    """
    factors, values, keys = gtsam.NonlinearFactorGraph(), gtsam.Values(), list[int]()
    for session, frame, numbers in zip(sessions, frames, number_vertices(sessions), strict=True):
        poses = se2.compose(frame, session.poses)
        for key, pose in zip(numbers.tolist(), poses, strict=True):
            values.insert(key, gtsam.Pose2(*pose))
        if not keys:
            factors.push_back(prior(0, poses[0]))
        for factor in list_factors(session, numbers.tolist()):
            factors.push_back(factor)
        keys += numbers[session.map.keyframes.scans].tolist()
    return GivenGraph(factors, values, keys, lambda factor: factor)


def join_keyframes(sessions: Sequence[Session]) -> Keyframes:
    """Joins the keyframes of all sessions; the poses of each session stay in the frame of this session.

    The numbers of scans become numbers of vertices in the joint graph. The georeference of the first session is kept.
    """
    own = [session.map.keyframes for session in sessions]
    firsts = np.cumsum([0, *(len(k.recordings) for k in own)])
    starts = np.cumsum([0, *(len(k.points) for k in own)])
    points = make_stored((int(starts[-1]),), KEYFRAME_POINT)
    for keyframes, start, end in zip(own, starts, starts[1:], strict=False):
        points[start:end] = keyframes.points
        release(points, keyframes.points)
    numbers = number_vertices(sessions)
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


def join_places(sessions: Sequence[Session]) -> PlaceTable:
    """Joins the place tables of all sessions; all descriptors must have been made with the same settings."""
    firsts = np.cumsum([0, *(len(session.map.keyframes) for session in sessions)])
    return PlaceTable(
        np.concatenate([session.map.places.keyframes + first for session, first in zip(sessions, firsts, strict=False)]),
        np.concatenate([session.map.places.descriptors for session in sessions]),
        sessions[0].map.places.made_with,
    )


# A session's graph is optimised with the edges in its file alone. If a pose moves by more than this [m], a warning says that
# other data, such as GNSS, determined the pose in the session's run.
_MOVED_M = 0.5


@dataclass(frozen=True, slots=True)
class Merged:
    """The result of a merge: several recordings as one map.

    Args:
        config: all settings.
        sessions: the sessions that were merged.
        recognitions: the result of recognition for each pair of sessions.
        links: the links between keyframes of different sessions that the map keeps, with the counts of their search.
        psi: (L, 2) psi per point of the two passes that each link ties: first with the sessions placed by recognition,
            without links, then at the optimum.
        residuals: (L,) residuals of the links at the optimum, in standard deviations.
        trajectories: the trajectory of each recording, all in the map's frame.
        kept: keyframes and places of the map, in the form in which they are stored.
        graph: the joint graph, with the links among its factors.
        values: poses of the graph's vertices, which are numbered from 0.
        map: the points of all keyframes.
        changes: objects that one recording shows and another one misses; empty if not asked for or if the search failed.
        sigmas: (R, K) uncertainty of each keyframe relative to each recording [m], see `measure_relative_uncertainty`.
        moved_m: for each session, the largest distance by which a pose moves if the session's graph is optimised alone [m].
        warnings: messages on steps that failed or were left out, with the reasons, and on sessions that may be misplaced.
    """

    config: Config
    sessions: tuple[Session, ...]
    recognitions: tuple[Recognition, ...]
    links: LoopSearch
    psi: NDArray[np.float64]
    residuals: NDArray[np.float64]
    trajectories: tuple[Trajectory, ...]
    kept: KeyframeMap
    graph: PoseGraph
    values: gtsam.Values
    map: PointMap
    changes: list[Change]
    sigmas: NDArray[np.float64]
    moved_m: tuple[float, ...]
    warnings: tuple[str, ...]

    @property
    def unit_m(self) -> float:
        """The unit in which the map was made [m]: the unit of the first recording if it is a lidar's, else a metre."""
        return self.kept.keyframes.unit_m or 1.0

    def scale(self, factor: float, config: Config, sessions: Sequence[Session]) -> Merged:
        """Returns the result with all lengths multiplied by a factor.

        Args:
            factor: length of the present unit, in the new unit.
            config: all settings in the new unit.
            sessions: the sessions in the new unit.
        """
        kept = self.kept.scale(factor)
        recordings = tuple(replace(recording, unit_m=self.unit_m) for recording in kept.keyframes.recordings)
        kept = replace(kept, keyframes=replace(kept.keyframes, recordings=recordings))
        return replace(
            self,
            config=config,
            sessions=tuple(sessions),
            links=replace(self.links, loops=[scale_tie(link, factor) for link in self.links.loops]),
            trajectories=tuple(scale_track(track, factor) for track in self.trajectories),
            kept=kept,
            graph=scale_graph(self.graph, factor),
            values=scale_values(self.values, factor),
            map=replace(self.map, points=factor * self.map.points),
            changes=[replace(c, place=factor * c.place, size_m=factor * c.size_m) for c in self.changes],
            sigmas=factor * self.sigmas,
            moved_m=tuple(factor * moved for moved in self.moved_m),
        )


def merge_sessions(sessions: Sequence[Session], config: Config, runner: Runner) -> Merged:
    """Makes one map of several sessions, in the frame of the first session.

    Args:
        sessions: two or more sessions.
        config: all settings.
        runner: does the work.

    Raises:
        EstimationError: no place that a session shares with the others is recognised with certainty, links to the session
            make the map worse, or the uncertainty of a session's trajectory cannot be computed.
    """
    beam = beam_of(config.estimator, sessions[0].map.keyframes.recordings[0].doppler_beta)
    with runner.time_stage("optimise"):
        sessions = [replace(session, map=describe_map(session.map, beam, runner.engine)) for session in sessions]
        chains = [_optimise_alone(session) for session in sessions]
        moved = tuple(_measure_move(session, chain) for session, chain in zip(sessions, chains, strict=True))
    with runner.time_stage("recognise"):
        recognitions = introduce(sessions, chains, config.estimator, beam, runner)
    keyframes = join_keyframes(sessions)
    groups = np.repeat(np.arange(len(sessions)), [len(session.map.keyframes) for session in sessions])
    frames, first = lay_out(sessions, chains, recognitions)
    del chains  # their eliminated graphs take more memory than anything else here
    problem = join_graphs(sessions, frames)
    start = np.concatenate(
        [se2.compose(f, session.map.keyframes.poses) for f, session in zip(frames, sessions, strict=True)]
    )
    with runner.time_stage("links"):
        before = MappedDrive.of(keyframes, start)
        closer = LoopCloser(
            problem, lambda poses: MappedDrive.of(keyframes, poses), config.estimator, beam, runner, before, groups
        )
        closer.start_from(first)
        if closer.loops:
            closer.look_around()
        links = closer.conclude()
        _check_joined(sessions, links.loops, groups)
    with runner.time_stage("optimise"):
        graph, optimum = problem.optimise(links.loops)
        marginals = compute_all_marginals(graph, optimum.values)
        poses, unknown = graph.poses_at(optimum.values), np.full((len(keyframes), 3, 3), np.nan)
        own = marginals.covariances if marginals.failure is None else unknown
        keyframes = replace(keyframes, poses=poses, covariances=own)
        residuals = _measure_residuals(links.loops, poses)
        shared = MappedDrive.of(keyframes), [start, poses], config.estimator, beam
        psi = np.array(runner.engine.map(score_loop, shared, links.loops)).reshape(-1, 2)
    with runner.time_stage("render"):
        rendered = _render(keyframes, config.estimator, beam, runner.engine)
    changes, sigmas = list[Change](), np.full((len(keyframes.recordings), len(keyframes)), np.inf)
    with runner.time_stage("changes"), runner.tolerate("the changes between the recordings"):
        sigmas = measure_relative_uncertainty(keyframes, Chain(MappedDrive.of(keyframes), graph, optimum.values))
        if config.merge.changes:
            changes = find_changes(keyframes, sigmas)
    return Merged(
        config=config,
        sessions=tuple(sessions),
        recognitions=tuple(recognitions),
        links=links,
        psi=psi,
        residuals=residuals,
        trajectories=_list_trajectories(sessions, optimum.values),
        kept=KeyframeMap(keyframes, join_places(sessions)),
        graph=graph,
        values=optimum.values,
        map=rendered,
        changes=changes,
        sigmas=sigmas,
        moved_m=moved,
        warnings=(
            *runner.warnings,
            *marginals.warnings,
            *_warn_of_ambiguity(sessions, recognitions),
            *_warn_of_moves(sessions, moved),
        ),
    )


def merge_in_unit(sessions: Sequence[Session], config: Config, runner: Runner) -> Merged:
    """Merges lidar sessions in the first session's unit of length, and returns the result in metres.

    Arguments and errors are those of `merge_sessions`.
    """
    unit_m = sessions[0].map.keyframes.unit_m or 1.0
    inside = [
        scale_session(session, 1.0 / unit_m, same_places=session.map.keyframes.unit_m == unit_m) for session in sessions
    ]
    return merge_sessions(inside, scale_settings(config, 1.0 / unit_m), runner).scale(unit_m, config, sessions)


def _optimise_alone(session: Session) -> Chain:
    """Optimises a session's own graph, and returns the session's keyframes with the graph and its optimum."""
    graph = join_graphs([session], [np.zeros(3)]).build_graph([])
    return Chain(MappedDrive.of(session.map.keyframes), graph, optimise(graph).values)


def _measure_move(session: Session, chain: Chain) -> float:
    """Returns the largest distance [m] by which a session's keyframes move when the session's graph is optimised alone."""
    off = chain.graph.poses_at(chain.values)[:, :2] - session.map.keyframes.poses[:, :2]
    return float(np.hypot(off[:, 0], off[:, 1]).max())


def _warn_of_moves(sessions: Sequence[Session], moved_m: Sequence[float]) -> list[str]:
    """Returns a warning for each session whose poses move by more than `_MOVED_M` when its graph is optimised alone.

    The graph's file then lacks data, such as GNSS fixes, that determined these poses in the session's run.
    """
    return [
        f"{session.folder}: if its graph.g2o is optimised alone, its poses move by up to "
        f"{far * (session.map.keyframes.unit_m or 1.0):.2f} m away from the result of its run; this file lacks data that "
        "the run used, such as GNSS or a gyroscope's, so the merge cannot use them"
        for session, far in zip(sessions, moved_m, strict=True)
        if far > _MOVED_M
    ]


def _warn_of_ambiguity(sessions: Sequence[Session], recognitions: Sequence[Recognition]) -> list[str]:
    """Returns a warning for each pair of sessions in which more submaps match several places than match only one place."""
    return [
        f"several places fit: {m.ambiguous} submaps of {sessions[m.later].folder} match more than one place of "
        f"{sessions[m.earlier].folder} about equally well and were not used; {m.matches} submaps match only one place"
        for m in recognitions
        if m.ambiguous > m.matches
    ]


def _check_joined(sessions: Sequence[Session], links: Sequence[Loop], groups: NDArray[np.int64]) -> None:
    """Raises EstimationError if the links that the map keeps do not join all sessions.

    `groups` is the index (K,) of the session of each keyframe.
    """
    joined = {0}
    for _ in sessions:
        for link in links:
            ends = {int(groups[link.earlier]), int(groups[link.later])}
            joined |= ends if ends & joined else set()
    apart = [str(sessions[n].folder) for n in range(len(sessions)) if n not in joined]
    if apart:
        raise EstimationError(
            f"{', '.join(apart)}: cannot be joined with the other recordings: some places look the same, but linking them "
            "makes the map worse, so they are probably different places",
            "leave these recordings out, or add a recording that passes places of these and of the others",
        )


def _measure_residuals(links: Sequence[Loop], poses: se2.Array) -> NDArray[np.float64]:
    """Returns the residual (L,) of each link at poses (K, 3) [m, m, rad] of the keyframes, in standard deviations."""
    exact = (Relative(se2.between(poses[link.earlier], poses[link.later]), np.zeros((3, 3))) for link in links)
    return np.sqrt([compute_chi_square(one, as_relative(link)) for one, link in zip(exact, links, strict=True)])


def _list_trajectories(sessions: Sequence[Session], values: gtsam.Values) -> tuple[Trajectory, ...]:
    """Returns the trajectory of all scans of each recording, given the poses `values` of the joint graph."""
    stamps = [own for session in sessions for own in session.stamps_us]
    firsts = accumulate(map(len, stamps), initial=0)
    return tuple(
        Trajectory(own, poses_of(values, len(own), partial(add, first))) for own, first in zip(stamps, firsts, strict=False)
    )


def _render(keyframes: Keyframes, estimator: EstimatorConfig, beam: Beam, engine: Engine) -> PointMap:
    """Renders the points of all keyframes as one map. Times are seconds since the start of the earliest recording.

    Args:
        keyframes: keyframes of all recordings.
        estimator: settings of the score.
        beam: the sensor's measurement errors.
        engine: engine that scores the points; the result does not depend on it.
    """
    count = int(np.diff(keyframes.rows, axis=1).sum())
    points, covariances = make_stored((count, 2)), make_stored((count, 3))
    times, apart, intensities = make_stored((count,)), make_stored((count,)), make_stored((count,))
    turn_s = max(recording.revolution_s for recording in keyframes.recordings)
    offsets = _space_out(keyframes.recordings, turn_s)
    first_us, at = min(recording.start_us for recording in keyframes.recordings), 0
    for k in range(len(keyframes)):
        begin, end = keyframes.rows[k]
        own, part = keyframes.points[begin:end], slice(at, at + int(end - begin))
        place_points(own, keyframes.poses[k], points[part])
        rays = own["ray"].astype(np.float64) + keyframes.poses[k, 2]
        covariances[part] = np.column_stack(
            compute_beam_covariance(own["range"].astype(np.float64), np.cos(rays), np.sin(rays), beam)
        )
        stamp, start = int(keyframes.stamps_us[k]), keyframes.recordings[int(keyframes.origins[k])].start_us
        since = own["time"].astype(np.float64)  # keyframes store times as float32, which would be too coarse after hours
        times[part] = since + 1e-6 * (stamp - first_us)
        apart[part] = since + 1e-6 * (stamp - start) + offsets[int(keyframes.origins[k])]
        intensities[part] = own["intensity"]
        at = part.stop
    release(points, covariances, times, apart, intensities, keyframes.points)
    placed = PointSet(points, np.empty((count, 2, 0)), covariances, apart)
    shares, matched = score_points(placed, turn_s, estimator, engine)
    return PointMap(points, times, intensities, shares, matched)


def _space_out(recordings: tuple[MappedRecording, ...], turn_s: float) -> list[float]:
    """Returns an offset [s] for the times of each recording, so that no two recordings overlap in time.

    The times count from the start of each recording. Without offsets, psi would take returns of two recordings with similar
    times for returns of one revolution, and would not match them. `turn_s` is the duration of a turn of the sensor [s].
    """
    lengths = [1e-6 * (recording.end_us - recording.start_us) + 2.0 * turn_s for recording in recordings]
    return [0.0, *accumulate(lengths)][:-1]
