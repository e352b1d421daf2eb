"""The merge: parts are recognised in each other, linked, optimised as one graph, and compared for changes.

results -> places recognised -> relations -> joint graph -> links -> one trajectory per recording -> one map -> changes
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.backend.loops.chain import Chain, Relative, as_relative, compute_chi_square
from mqslam.backend.loops.closing import LoopCloser, score_loop
from mqslam.backend.loops.passes import MappedDrive, Passes
from mqslam.backend.loops.recognition import describe_map
from mqslam.backend.marginals import PoseCovariances, compute_all_marginals
from mqslam.backend.pose_graph import PoseGraph, optimise, pose_of
from mqslam.backend.problem import GivenGraph
from mqslam.config import Config, EstimatorConfig
from mqslam.core import se2
from mqslam.core.keyframes import KEYFRAME_POINT, KeyframeMap, Keyframes, PlaceTable
from mqslam.core.measurement import Loop, LoopSearch
from mqslam.core.point_map import PointMap
from mqslam.core.stored import make_stored, release
from mqslam.core.trajectory import Trajectory
from mqslam.errors import EstimationError
from mqslam.execution.runner import Runner
from mqslam.factors.between import prior
from mqslam.merging.changes import Change, find_changes, measure_relative_uncertainty
from mqslam.merging.part import Session, build_alone, list_factors
from mqslam.merging.recognition import Recognition, introduce, lay_out
from mqslam.merging.rendering import render_keyframes
from mqslam.psi.place import Beam, beam_of


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


def join_graphs(parts: Sequence[Session], frames: Sequence[se2.Array]) -> GivenGraph:
    """Joins the graphs of all parts; only the first pose of the first one is held.

    Args:
        parts: the parts.
        frames: (3,) pose of the frame of each part in that of the first one, from which the optimisation starts.

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
        for factor in list_factors(part, numbers.tolist()):
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


# If the edges in a result's graph alone move a pose farther than this [m], a warning says that what is no edge, such as
# GNSS, has held the result.
_MOVED_M = 0.5


@dataclass(frozen=True, slots=True)
class Merged:
    """Several recordings as one map.

    Args:
        config: all settings.
        parts: what was merged.
        recognitions: what recognition says about each two parts.
        links: those between keyframes of different parts that the map keeps, and what the search for them has led to.
        psi: (L, 2) psi per point of each link's passes, with the parts laid on each other as they were and at the optimum.
        residuals: (L,) of the links at the optimum, in standard deviations.
        trajectories: of each recording, in one frame.
        kept: keyframes and places of the map.
        graph: the joint graph, its links among its factors.
        values: of its vertices, which are numbered from 0.
        map: all keyframes rendered.
        changes: what one recording shows and another contradicts.
        sigmas: (R, K) how well it is known, for each recording and keyframe, how the two lie to each other [m].
        moved_m: for each part, how far the edges of its graph alone move a pose of it [m].
        warnings: what could not be done, and why.
    """

    config: Config
    parts: tuple[Session, ...]
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


def merge_parts(parts: Sequence[Session], config: Config, runner: Runner) -> Merged:
    """Makes one map of several parts, in the frame of the first one.

    Args:
        parts: two or more.
        config: all settings.
        runner: does the work.

    Raises:
        EstimationError: a part shares no place with the others that is recognised without doubt.
    """
    beam = beam_of(config.estimator, parts[0].map.keyframes.recordings[0].doppler_beta)
    with runner.time_stage("optimise"):
        parts = [replace(part, map=describe_map(part.map, beam, runner.engine)) for part in parts]
        chains = [_optimise_alone(part) for part in parts]
        moved = tuple(_measure_move(part, chain) for part, chain in zip(parts, chains, strict=True))
    with runner.time_stage("recognise"):
        recognitions = introduce(parts, chains, config.estimator, beam, runner)
    keyframes = join_keyframes(parts)
    groups = np.repeat(np.arange(len(parts)), [len(part.map.keyframes) for part in parts])
    frames, first = lay_out(parts, chains, recognitions)
    del chains  # what they have eliminated takes more memory than anything else here
    problem = join_graphs(parts, frames)
    start = np.concatenate([se2.compose(f, part.map.keyframes.poses) for f, part in zip(frames, parts, strict=True)])
    with runner.time_stage("links"):
        before = MappedDrive.of(keyframes, start)
        closer = LoopCloser(
            problem, lambda poses: MappedDrive.of(keyframes, poses), config.estimator, beam, runner, before, groups
        )
        closer.start_from(first)
        if closer.loops:
            closer.look_around()
        links = closer.conclude()
        _check_joined(parts, links.loops, groups)
    with runner.time_stage("optimise"):
        graph, optimum = problem.optimise(links.loops)
        sure = compute_all_marginals(graph, optimum.values)
        poses = graph.poses_at(optimum.values)
        keyframes = replace(keyframes, poses=poses, covariances=_list_covariances(sure, len(keyframes)))
        residuals = _measure_residuals(links.loops, poses)
        shared = MappedDrive.of(keyframes), [start, poses], config.estimator, beam
        psi = np.array(runner.engine.map(_score, shared, links.loops)).reshape(-1, 2)
    with runner.time_stage("render"):
        rendered = render_keyframes(keyframes, config.estimator, beam, runner.engine)
    changes, sigmas = list[Change](), np.full((len(keyframes.recordings), len(keyframes)), np.inf)
    with runner.time_stage("changes"), runner.tolerate("the changes between the recordings"):
        sigmas = measure_relative_uncertainty(keyframes, Chain(MappedDrive.of(keyframes), graph, optimum.values))
        if config.merge.changes:
            changes = find_changes(keyframes, sigmas)
    return Merged(
        config=config,
        parts=tuple(parts),
        recognitions=tuple(recognitions),
        links=links,
        psi=psi,
        residuals=residuals,
        trajectories=_list_trajectories(parts, optimum.values),
        kept=KeyframeMap(keyframes, join_places(parts)),
        graph=graph,
        values=optimum.values,
        map=rendered,
        changes=changes,
        sigmas=sigmas,
        moved_m=moved,
        warnings=(
            *runner.warnings,
            *sure.warnings,
            *_warn_of_ambiguity(parts, recognitions),
            *_warn_of_moves(parts, moved),
        ),
    )


def _optimise_alone(part: Session) -> Chain:
    """Returns a part's own trajectory and how sure its graph is of it."""
    graph = build_alone(part)
    optimum = optimise(graph)
    return Chain(MappedDrive.of(part.map.keyframes), graph, optimum.values)


def _measure_move(part: Session, chain: Chain) -> float:
    """Returns how far the optimum of a part's edges is from where its keyframes lie, at most [m]."""
    off = chain.graph.poses_at(chain.values)[:, :2] - part.map.keyframes.poses[:, :2]
    return float(np.hypot(off[:, 0], off[:, 1]).max())


def _warn_of_moves(parts: Sequence[Session], moved_m: Sequence[float]) -> list[str]:
    """Returns a warning for each part that was held by what its file lacks."""
    return [
        f"{part.folder}: the edges in its graph.g2o alone move it by up to {far:.2f} m; the gyroscope or GNSS that has held "
        "it is not in that file, and takes no part in the merge"
        for part, far in zip(parts, moved_m, strict=True)
        if far > _MOVED_M
    ]


def _warn_of_ambiguity(parts: Sequence[Session], recognitions: Sequence[Recognition]) -> list[str]:
    """Returns a warning for each two parts of which more submaps match several places than match one."""
    return [
        f"several places fit: {m.ambiguous} submaps of {parts[m.later].folder} match more than one place of "
        f"{parts[m.earlier].folder} about as well, and {m.matches} match one; the former were not used"
        for m in recognitions
        if m.ambiguous > m.matches
    ]


def _check_joined(parts: Sequence[Session], links: Sequence[Loop], groups: NDArray[np.int64]) -> None:
    """Raises EstimationError unless the links that the map has kept still join all parts."""
    joined = {0}
    for _ in parts:
        for link in links:
            ends = {int(groups[link.earlier]), int(groups[link.later])}
            joined |= ends if ends & joined else set()
    apart = [str(parts[n].folder) for n in range(len(parts)) if n not in joined]
    if apart:
        raise EstimationError(
            f"{', '.join(apart)}: the places that it seems to share with the other recordings make no better map",
            "give recordings that pass through the same streets",
        )


def _score(shared: tuple[Passes, Sequence[se2.Array], EstimatorConfig, Beam], link: Loop) -> list[float]:
    drive, tracks, estimator, beam = shared
    return score_loop(drive, link, tracks, estimator, beam)


def _list_covariances(sure: PoseCovariances, count: int) -> NDArray[np.float64]:
    """Returns the covariances (K, 3, 3) of keyframes, NaN where they are not known."""
    return np.full((count, 3, 3), np.nan) if sure.failure is not None else sure.covariances


def _measure_residuals(links: Sequence[Loop], poses: se2.Array) -> NDArray[np.float64]:
    """Returns the residual (L,) of each link at poses (K, 3) of the keyframes, in standard deviations."""
    lies = [se2.between(poses[link.earlier], poses[link.later]) for link in links]
    known = np.zeros((3, 3))
    squares = [compute_chi_square(Relative(p, known), as_relative(k)) for p, k in zip(lies, links, strict=True)]
    return np.sqrt(squares)


def _list_trajectories(parts: Sequence[Session], values: gtsam.Values) -> tuple[Trajectory, ...]:
    """Returns the trajectory of each recording, all scans of it."""
    trajectories, first = [], 0
    for stamps in (stamps for part in parts for stamps in part.stamps_us):
        poses = np.array([pose_of(values, k) for k in range(first, first + len(stamps))])
        poses[:, 2] = np.unwrap(poses[:, 2])
        trajectories.append(Trajectory(stamps, poses))
        first += len(stamps)
    return tuple(trajectories)
