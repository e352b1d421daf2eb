"""Searches for loops in rounds. Each round searches around the trajectory that the loops of earlier rounds have corrected.

The graph gives the relative pose of two scans and its covariance. Pairs of scans that may show the same place, given this
pose and covariance, are registered by psi. Where the trajectory stays too uncertain for registration, places are recognised
by their appearance. A loop is kept if the trajectory does not rule it out, if it agrees with its neighbours, and if it does
not clearly increase psi of its two passes. Where two passes of a lidar show only the walls of a corridor, a loop states only
their relative position across the corridor, and free space then shows their relative position along it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.backend.loops import passes
from mqslam.backend.loops.chain import (
    LARGEST_CHI_SQUARE,
    Chain,
    Relative,
    SubmapLayout,
    as_relative,
    compute_chi_square,
    compute_layouts,
    keep_consistent,
)
from mqslam.backend.loops.free_space import Beams, contradicts, place_along
from mqslam.backend.loops.passes import (
    LATER_SHARE,
    MATCHED,
    SPACING_M,
    SUBMAP_M,
    Passes,
    TrackedRun,
    render_passes,
)
from mqslam.backend.loops.recognition import PLACE_SPACING_M, Hypothesis, PlaceDatabase, describe_places, recognise
from mqslam.backend.loops.registration import (
    align_near,
    align_passes,
    find_least_shown,
    is_unrivalled,
    score_at_pose,
)
from mqslam.backend.loops.rigid import move_rigidly
from mqslam.backend.pose_graph import Optimum, PoseGraph
from mqslam.backend.problem import GraphProblem
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.measurement import Loop, LoopSearch
from mqslam.core.scans import Scans
from mqslam.execution.progress import Progress
from mqslam.execution.runner import Runner
from mqslam.mapping.keyframing import pick_spaced
from mqslam.psi.place import Beam, PointSet
from mqslam.psi.score import make_references

# Largest distance [m] between two passes at which they still see the same objects.
_REACH_M = 12.0
# Least half width of the search for the later pass's position [m]. It is wider than most trajectories need: in a street
# whose structure repeats, the search then finds several poses, however certain the trajectory is.
_SEARCH_M = 15.0
# Least half width of the search in yaw [rad].
_SEARCH_RAD = 0.03
# Largest half width of the search for the later pass's position [m]. It bounds the time of the search.
GATE_M = 40.0
# Largest half width of the search in yaw [rad]. It bounds the time of the search.
_GATE_RAD = 0.3
# Largest number of scans between which the trajectory's uncertainty decides where places are recognised. It bounds the time,
# which grows with its square.
_NODES = 200
# Least half width [m] of the search along a direction about which a loop says nothing: several doors must be in reach.
_ALONG_M = 4.0
# Half width of the search, in standard deviations of the two passes' relative pose in the trajectory. If the half width is
# larger than GATE_M or _GATE_RAD, the passes are not compared.
_SIGMAS = 3.0
# Largest number of earlier passes with which a scan is compared; the nearest ones are taken.
_PASSES = 1
# A pair of scans is not compared if it neighbours a compared pair: if the path between the two earlier scans is at most
# LEAST_PATH_M, and the path between the two later scans is at most LEAST_PATH_M divided by this factor.
_TRIED_FACTOR = 20.0
# A loop that does not lower psi of its two passes is kept if psi in the optimised map is at most this many times the smaller
# of two values: psi before the loops, and psi with the passes registered on each other.
_KEPT = 1.1
ROUNDS = 10
"""Largest number of rounds; it bounds the time. Each round starts from the trajectory that the loops found so far have
corrected, so that it reaches more pairs of passes. The search ends earlier if a round finds no loop."""

_log = logging.getLogger(__name__)


class Candidate(NamedTuple):
    """A pair of scans that may show one place.

    Args:
        earlier, later: numbers of the two scans.
        reach_m: half width of the search around the later scan's position in the trajectory [m].
        reach_rad: half width of the search in yaw [rad].
        chain: pose of the later scan in the frame of the earlier scan, as the trajectory states it.
        layout: uncertainty of the submaps around both scans, by errors of the trajectory along which they are rendered.
    """

    earlier: int
    later: int
    reach_m: float
    reach_rad: float
    chain: Relative
    layout: SubmapLayout


def find_candidates(
    chain: Chain, tried: AbstractSet[tuple[int, int]], groups: NDArray[np.int64] | None = None
) -> tuple[list[Candidate], list[tuple[int, int]]]:
    """Finds pairs of scans that may show one place.

    A pair is a candidate if the distance of its scans, minus `_SIGMAS` of its standard deviations, is so short that both
    passes see the same objects. Only the nearest `_PASSES` earlier passes of a later scan are taken, each with its nearest
    scan. A pair is left out if it or a neighbouring pair has been tried.

    Args:
        chain: the trajectory, with its uncertainty.
        tried: pairs (earlier, later) that have been tried.
        groups: (N,) number of each scan's group, such as its session in a merge, if only pairs of scans of different groups
            are wanted; None takes all pairs.

    Returns:
        The candidates, and the pairs that cannot be compared because their relative pose is too uncertain for the search.

    Raises:
        EstimationError: the uncertainty cannot be computed.
    """
    drive, widest_m, least_path_m = chain.drive, _REACH_M + GATE_M, passes.LEAST_PATH_M
    of_scans = passes.find_passes(
        drive.travelled, drive.poses, SPACING_M, least_path_m, lambda path_m: np.full_like(path_m, widest_m)
    )
    if groups is not None:
        of_scans = [[(a, b) for a, b in nearest if groups[a] != groups[b]] for nearest in of_scans]
    pairs = [pair for nearest in of_scans for pair in nearest]
    relatives = dict(zip(pairs, chain.relate(pairs), strict=True))

    def stretch(pair: tuple[int, int]) -> tuple[float, float]:
        """Returns coordinates [m] in which neighbouring pairs are at most `least_path_m` apart.

        The first coordinate is the length of the path up to the earlier scan. The second one is the length up to the later
        scan times _TRIED_FACTOR, since neighbours must lie closer to each other by this factor along the later pass.
        """
        return float(drive.travelled[pair[0]]), float(drive.travelled[pair[1]]) * _TRIED_FACTOR

    known = cKDTree(np.array([stretch(pair) for pair in sorted(tried)]).reshape(-1, 2))
    found, unsure = [], []
    for nearest in of_scans:
        for pair in [pair for pair in nearest if may_meet(relatives[pair])][:_PASSES]:
            if known.query_ball_point(stretch(pair), least_path_m):
                continue
            if is_beyond_gate(relatives[pair]):
                unsure.append(pair)
            else:
                found.append(pair)
    layouts = compute_layouts(chain, found)
    candidates = [
        Candidate(*pair, *compute_reach(relatives[pair]), relatives[pair], layout)
        for pair, layout in zip(found, layouts, strict=True)
    ]
    return candidates, unsure


def compute_reach(relative: Relative) -> tuple[float, float]:
    """Returns the half widths, in position [m] and in yaw [rad], of a search that covers a relative pose's uncertainty."""
    sigma_m = float(np.sqrt(np.linalg.eigvalsh(relative.covariance[:2, :2])[-1]))
    sigma_rad = float(np.sqrt(relative.covariance[2, 2]))
    return max(_SEARCH_M, _SIGMAS * sigma_m), max(_SEARCH_RAD, _SIGMAS * sigma_rad)


def is_beyond_gate(relative: Relative) -> bool:
    """Returns whether a relative pose is too uncertain for the widest search."""
    reach_m, reach_rad = compute_reach(relative)
    return reach_m > GATE_M or reach_rad > _GATE_RAD


def may_meet(relative: Relative, slack_m: float = 0.0) -> bool:
    """Returns whether two scans may lie near enough to show the same place, given the pose of one relative to the other.

    With `slack_m`, a distance that is longer by so much [m] is near enough, too.
    """
    apart = relative.motion[:2]
    distance = float(np.hypot(*apart))
    if distance <= _REACH_M + slack_m:
        return True
    towards = apart / distance
    sigma = float(np.sqrt(towards @ relative.covariance[:2, :2] @ towards))
    return distance <= _REACH_M + slack_m + _SIGMAS * sigma


def find_out_of_reach(chain: Chain, places: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Finds places that may show an earlier place that the search around the trajectory does not reach.

    The uncertainty of the trajectory is computed between scans that are GATE_M apart on the path, or farther apart if there
    would otherwise be more than `_NODES` of them. If the pose of each of these scans relative to the first scan is certain
    enough, the search reaches every place, and no other pairs are examined.

    Args:
        chain: the trajectory, with its uncertainty.
        places: (P,) numbers of the scans at the places, increasing.

    Returns:
        (P, P) whether the place of a row may show the earlier place of a column. A row is all False if the search reaches
        all earlier places that the place of the row may show.

    Raises:
        EstimationError: the uncertainty of the trajectory cannot be computed.
    """
    travelled = chain.drive.travelled
    spacing_m = max(GATE_M, float(travelled[-1]) / _NODES)
    nodes = pick_spaced(travelled, spacing_m)
    pairs = [(int(nodes[0]), int(b)) for b in nodes[1:]]
    if not any(map(is_beyond_gate, chain.relate(pairs))):
        return np.zeros((len(places), len(places)), dtype=bool)
    later, earlier = np.tril_indices(len(nodes), -1)
    apart = travelled[nodes[later]] - travelled[nodes[earlier]] > passes.LEAST_PATH_M
    later, earlier = later[apart], earlier[apart]
    pairs = list(zip(nodes[earlier].tolist(), nodes[later].tolist(), strict=True))
    visible = np.zeros((len(nodes), len(nodes)), dtype=np.bool_)
    unsure = visible.copy()
    for a, b, relative in zip(earlier, later, chain.relate(pairs), strict=True):
        visible[b, a] = may_meet(relative, spacing_m)  # the places of a node lie up to this much farther along the path
        unsure[b, a] = visible[b, a] and is_beyond_gate(relative)
    visible &= np.asarray(unsure.any(axis=1))[:, None]
    node = np.maximum(np.searchsorted(nodes, places, side="right") - 1, 0)
    allowed: NDArray[np.bool_] = visible[np.ix_(node, node)]
    return np.asarray(allowed & (travelled[places][:, None] - travelled[places][None, :] > passes.LEAST_PATH_M))


class CandidateScore(NamedTuple):
    """The result of the registration of a candidate by psi.

    Args:
        loop: the loop; None unless psi confirms it and the trajectory allows it.
        ambiguous: whether the passes match at several poses in reach of the search, or at one that free space contradicts.
        implausible: whether the passes match only at a place that the trajectory rules out.
        along: (2,) unit vector, in the frame of the earlier scan, along which the loop says nothing about the position; None
            if there is no such direction.
    """

    loop: Loop | None = None
    ambiguous: bool = False
    implausible: bool = False
    along: NDArray[np.float64] | None = None


def compare_passes(
    drive: Passes,
    candidates: Sequence[Candidate],
    estimator: EstimatorConfig,
    beam: Beam,
    engine: Engine,
    progress: Progress,
) -> list[CandidateScore]:
    """Registers the two passes of every candidate; returns one result per candidate.

    Args:
        drive: scans under the present trajectory.
        candidates: pairs of scans that may show one place.
        estimator: settings of the score.
        beam: the sensor's measurement errors.
        engine: engine that registers the passes; the result does not depend on it.
        progress: called after each candidate.
    """

    def report(number: int, comparison: CandidateScore) -> None:
        progress("loops", number, len(candidates))

    return engine.map(_compare, (drive, estimator, beam), candidates, report)


def _compare(shared: tuple[Passes, EstimatorConfig, Beam], candidate: Candidate) -> CandidateScore:
    """Registers the two passes of a candidate, and decides whether they are a loop; `shared` is as in `_place_open_loop`."""
    drive, estimator, beam = shared
    earlier, later, _, _, chain, layout = candidate
    submaps = render_passes((drive, earlier), (drive, later), beam)
    reach, is_lidar = (candidate.reach_m, candidate.reach_rad), drive.shows_surfaces
    found = align_passes(*submaps, chain.motion, reach, estimator, on_surfaces=is_lidar, partly=is_lidar)
    if found is None:
        return CandidateScore()
    if not is_unrivalled(found, MATCHED):
        return CandidateScore(ambiguous=True)
    if is_lidar and found.along is None and np.cos(found.pose[2]) < 0.0:
        along = find_least_shown(move_rigidly(submaps[1], found.pose))
        reach_m = min(_find_reach(chain, along), LATER_SHARE * SUBMAP_M)
        beams, expected_m = _find_beams(drive, candidate[:2], submaps), float((chain.motion - found.pose)[:2] @ along)
        if contradicts(*beams, found.pose, along, (expected_m - reach_m, expected_m + reach_m)):
            return CandidateScore(ambiguous=True)
    loop = Loop(earlier, later, found.pose, layout.widen(found.pose, found.covariance), found.matched, found.psi)
    is_plausible = compute_chi_square(chain, as_relative(loop)) <= LARGEST_CHI_SQUARE
    return CandidateScore(loop, along=found.along) if is_plausible else CandidateScore(implausible=True)


def _place_open_loop(
    shared: tuple[Passes, EstimatorConfig, Beam], open_loop: tuple[Loop, NDArray[np.float64], Relative]
) -> tuple[Loop, bool]:
    """Finds the position of a loop's later pass along the direction about which the loop says nothing.

    Args:
        shared: scans under the present trajectory, settings of the score, and the sensor's errors.
        open_loop: the loop; the direction (2,), a unit vector in the frame of its earlier scan; and the pose of its later
            scan in this frame, as the trajectory states it.

    Returns:
        The loop with its new pose, and whether free space shows the position along the direction. If free space does not
        show it, the pose has the lowest psi near the pose by the trajectory. If the trajectory is too uncertain, or rules
        out this pose, the loop is returned unchanged.
    """
    (drive, estimator, beam), (loop, along, chain) = shared, open_loop
    reach_m = _find_reach(chain, along)
    if reach_m > LATER_SHARE * SUBMAP_M:
        return loop, False
    earlier, later = render_passes((drive, loop.earlier), (drive, loop.later), beam)
    pose = align_near(make_references(earlier), later, loop.pose, chain.motion, along, estimator)
    if pose is None or compute_chi_square(chain, as_relative(replace(loop, pose=pose))) > LARGEST_CHI_SQUARE:
        return loop, False
    near, expected_m = replace(loop, pose=pose), float((chain.motion - pose)[:2] @ along)
    reach = expected_m - reach_m, expected_m + reach_m
    beams = _find_beams(drive, (loop.earlier, loop.later), (earlier, later))
    placed = place_along(near, along, reach, *beams, estimator.cluster_m)
    return (near, False) if placed is None else (placed, True)


def _find_reach(chain: Relative, along: NDArray[np.float64]) -> float:
    """Returns how far [m] along a direction (2,) the later pass may lie from its pose `chain` by the trajectory."""
    return max(_SIGMAS * float(np.sqrt(along @ chain.covariance[:2, :2] @ along)), _ALONG_M)


def _find_beams(drive: Passes, scans: tuple[int, int], submaps: tuple[PointSet, PointSet]) -> tuple[Beams, Beams]:
    """Returns the beams of the submaps around an earlier and a later scan, given the scans' numbers and both submaps."""
    first, second = passes.find_origins(drive, *scans)
    return Beams(first, submaps[0].points), Beams(second, submaps[1].points)


def confirm_by_map(
    loops: Sequence[Loop],
    drive: Passes,
    after: se2.Array,
    estimator: EstimatorConfig,
    beam: Beam,
    engine: Engine,
) -> list[Loop]:
    """Returns the loops that do not clearly increase psi of their two passes.

    Psi with all loops must be lower than psi without loops, or hardly higher (see `_KEPT`).

    Args:
        loops: all loops in the graph.
        drive: scans under the trajectory before the loops.
        after: (N, 3) poses of the scans with the loops [m, m, rad].
        estimator: settings of the score.
        beam: the sensor's measurement errors.
        engine: engine that scores the passes; the result does not depend on it.
    """
    better = engine.map(_improves, (drive, after, estimator, beam), loops)
    return [loop for loop, keep in zip(loops, better, strict=True) if keep]


def _improves(shared: tuple[Passes, se2.Array, EstimatorConfig, Beam], loop: Loop) -> bool:
    """Returns whether psi of a loop's two passes is lower with all loops than without loops, or hardly higher (`_KEPT`).

    `shared` holds the arguments `drive`, `after`, `estimator` and `beam` of `confirm_by_map`.
    """
    drive, after, estimator, beam = shared
    before_psi, after_psi = score_loop((drive, [drive.poses, after], estimator, beam), loop)
    return after_psi < before_psi or after_psi <= _KEPT * min(before_psi, loop.psi)


def score_loop(shared: tuple[Passes, Sequence[se2.Array], EstimatorConfig, Beam], loop: Loop) -> list[float]:
    """Returns psi per point of a loop's two passes under each of several trajectories.

    The submaps are rendered only once, so that the trajectories differ only in the relative pose of the submaps.

    Args:
        shared: (1) scans under the trajectory with which the submaps are rendered, (2) for each trajectory that is scored,
            the poses (N, 3) [m, m, rad] of the scans, (3) settings of the score, (4) the sensor's errors.
        loop: the loop.

    Returns:
        One value per trajectory, in the order of `shared`.
    """
    drive, tracks, estimator, beam = shared
    reference, query = render_passes((drive, loop.earlier), (drive, loop.later), beam)
    references = make_references(reference)
    motions = (se2.between(poses[loop.earlier], poses[loop.later]) for poses in tracks)
    return [score_at_pose(references, query, motion, estimator) for motion in motions]


class LoopCloser:
    """Searches for loops that psi confirms, that fit the trajectory and neighbouring loops, and that hardly worsen the map.

    Args:
        problem: the trajectory to which loops are added.
        place: places the scans at given poses (N, 3) [m, m, rad].
        estimator: settings of the score.
        beam: the sensor's measurement errors.
        runner: gives the engine that compares scans, and reports progress.
        before: the scans as the trajectory without loops places them, with which the map with loops is compared; None takes
            the first optimised trajectory.
        groups: (N,) number of each scan's group, if only loops between different groups are wanted; None searches for all.

    Attributes:
        loops: the loops that have been added to the trajectory and kept.
    """

    def __init__(
        self,
        problem: GraphProblem,
        place: Callable[[se2.Array], Passes],
        estimator: EstimatorConfig,
        beam: Beam,
        runner: Runner,
        before: Passes | None = None,
        groups: NDArray[np.int64] | None = None,
    ) -> None:
        self._problem, self._place, self._estimator, self._beam, self._runner = problem, place, estimator, beam, runner
        self._before, self._groups = before, groups
        self.loops: list[Loop] = []
        self._compared: set[tuple[int, int]] = set()
        self._decided: set[tuple[int, int]] = set()
        self._open: dict[tuple[int, int], NDArray[np.float64]] = {}  # directions about which the pairs' loops say nothing
        self._latest: tuple[list[Loop], PoseGraph, Optimum] | None = None  # what `_solve` returned last, with its loops
        self._implausible: set[tuple[int, int]] = set()
        self._ambiguous = self._unsure = 0
        self._supposed: set[tuple[int, int]] = set()  # the pairs that were compared although the trajectory is too uncertain
        self._recognised = 0  # number of pairs that the recognition of places has compared
        self._alike: set[int] = set()  # the scans whose submaps fit several poses
        self._elsewhere: set[tuple[int, int]] = set()  # the recognised pairs that the trajectory rules out

    def look_around(self) -> None:
        """Searches for loops around the trajectory, in rounds.

        Raises:
            EstimationError: the uncertainty of the trajectory cannot be computed.
        """
        for _ in range(ROUNDS):
            chain = self._optimise()
            new = self._compare(chain)
            if not new:
                break
            kept = keep_consistent(new, chain, passes.LEAST_PATH_M)
            del chain  # frees the eliminated graph, which takes more memory than anything else here
            self.join(kept)
        for _ in range(ROUNDS):  # each placed loop makes the trajectory more certain where others are to be placed
            if not self._place_open_loops():
                break

    def _place_open_loops(self) -> bool:
        """Finds by free space the positions of loops along the directions about which these loops say nothing.

        Returns:
            Whether the positions of some of these loops were found, and the positions of others were not.
        """
        unplaced = [loop for loop in self.loops if (loop.earlier, loop.later) in self._open]
        if not unplaced:
            return False
        chain, pairs = self._optimise(), [(loop.earlier, loop.later) for loop in unplaced]
        open_loops = list(zip(unplaced, map(self._open.__getitem__, pairs), chain.relate(pairs), strict=True))
        found = self._runner.engine.map(_place_open_loop, (chain.drive, self._estimator, self._beam), open_loops)
        placed = [
            loop
            for (loop, is_placed), (_, _, relative) in zip(found, open_loops, strict=True)
            if is_placed and compute_chi_square(relative, as_relative(loop)) <= LARGEST_CHI_SQUARE
        ]
        placed = keep_consistent(placed, chain, passes.LEAST_PATH_M)
        del chain
        _log.info("free space shows the positions of %d of %d loops along corridors", len(placed), len(unplaced))
        if not placed:  # other poses of loops that stay open hardly change the trajectory
            return False
        for loop in placed:
            del self._open[loop.earlier, loop.later]
        near = [loop for loop, is_placed in found if not is_placed]
        new = {(loop.earlier, loop.later): loop for loop in (*near, *placed)}
        self.loops = [loop for loop in self.loops if (loop.earlier, loop.later) not in new]
        self.join(list(new.values()))
        return len(placed) < len(unplaced)

    def look_everywhere(self) -> bool:
        """Recognises places that the search around the trajectory does not reach; returns whether new loops were kept.

        A lidar sees few metres, and corridors look alike. Its passes are therefore also compared where the trajectory places
        them, although this search may be too narrow. Like places that look alike, such passes count only in rows that agree.

        Raises:
            EstimationError: the uncertainty of the trajectory cannot be computed.
        """
        chain, beam, engine = self._optimise(), self._beam, self._runner.engine
        places = pick_spaced(chain.drive.travelled, PLACE_SPACING_M)
        allowed = find_out_of_reach(chain, places)
        asked = allowed.any(axis=1)
        if not asked.any():
            return False
        database = PlaceDatabase.of(chain.drive, describe_places(chain.drive, beam, engine))
        allowed, supposed = allowed[asked], self._suppose(chain)
        found = recognise(chain.drive, places[asked], database, allowed, self._estimator, beam, engine, supposed)
        if not found.compared:
            return False
        matches = [match for row in found.rows for match in row]
        ends = [(match.earlier, match.later) for match in matches]
        widened = [
            Loop(*pair, m.pose, layout.widen(m.pose, m.covariance), m.matched, m.psi)
            for pair, m, layout in zip(ends, matches, compute_layouts(chain, ends), strict=True)
        ]
        plausible = [
            loop
            for loop, relative in zip(widened, chain.relate(ends), strict=True)
            if compute_chi_square(relative, as_relative(loop)) <= LARGEST_CHI_SQUARE
        ]
        self._recognised += found.compared
        self._alike |= set(found.ambiguous)
        self._elsewhere |= set(ends) - {(loop.earlier, loop.later) for loop in plausible}
        kept = keep_consistent(plausible, chain, passes.LEAST_PATH_M)
        del chain
        before = {(loop.earlier, loop.later) for loop in self.loops}
        self.join([loop for loop in kept if (loop.earlier, loop.later) not in before])
        added = {(loop.earlier, loop.later) for loop in self.loops} - before
        self._decided |= added
        _log.info("recognition of places adds %d loops; %d submaps match several places", len(added), len(found.ambiguous))
        return bool(added)

    def _suppose(self, chain: Chain) -> list[Hypothesis]:
        """Returns hypotheses for pairs of a lidar's passes whose relative pose may be off by more than the widest search."""
        if not chain.drive.shows_surfaces:
            return []
        unsure = find_candidates(chain, self._decided | self._supposed, self._groups)[1]
        self._supposed |= set(unsure)
        return [
            Hypothesis(*pair, relative.motion, (GATE_M, _GATE_RAD))
            for pair, relative in zip(unsure, chain.relate(unsure), strict=True)
        ]

    def start_from(self, first: Sequence[Loop]) -> None:
        """Adds loops known before the search; neither their pairs of scans nor neighbouring pairs are compared again."""
        self._decided = {(loop.earlier, loop.later) for loop in first}
        self.join(first)

    def join(self, new: Sequence[Loop]) -> None:
        """Adds new loops to the trajectory, and then keeps those loops, old or new, that `confirm_by_map` returns."""
        loops, before = [*self.loops, *new], self._before
        assert before is not None  # it was given, or set when the trajectory was optimised
        graph, optimum = self._solve(loops)
        after = graph.poses_at(optimum.values)
        self.loops = confirm_by_map(loops, before, after, self._estimator, self._beam, self._runner.engine)

    def conclude(self) -> LoopSearch:
        """Returns and logs the kept loops, with the counts of compared and rejected pairs of scans."""
        ambiguous, implausible = self._ambiguous, len(self._implausible | self._elsewhere)
        tried = len(self._compared) + self._recognised
        _log.info("%d of %d pairs of passes are loops that the map keeps", len(self.loops), tried)
        _log.info("%d pairs match at several places, %d only where the trajectory rules it out", ambiguous, implausible)
        return LoopSearch(self.loops, tried, ambiguous, implausible, self._unsure, len(self._alike))

    def _compare(self, chain: Chain) -> list[Loop]:
        """Compares passes around a trajectory; returns the new loops that psi confirms and the trajectory allows.

        A pair that the trajectory rules out is compared again in the next round, whose trajectory may allow it. No other
        pair is compared twice.
        """
        runner = self._runner
        candidates, unsure = find_candidates(chain, self._decided, self._groups)
        scores = compare_passes(chain.drive, candidates, self._estimator, self._beam, runner.engine, runner.progress)
        self._implausible = {c[:2] for c, score in zip(candidates, scores, strict=True) if score.implausible}
        self._compared |= {c[:2] for c in candidates}
        self._decided |= {c[:2] for c in candidates} - self._implausible
        self._ambiguous += sum(score.ambiguous for score in scores)
        self._unsure = len(unsure)
        new: list[Loop] = []
        for loop, along in ((score.loop, score.along) for score in scores):
            if loop is None or (along is not None and self._groups is not None):
                continue  # recordings are joined only by loops that state their whole relative pose
            if along is not None:
                self._open[loop.earlier, loop.later] = along
            new.append(loop)
        return new

    def _optimise(self) -> Chain:
        """Returns the trajectory, optimised with the loops so far; its first result becomes `before` if none was given."""
        graph, optimum = self._solve(self.loops)
        chain = Chain(self._place(graph.poses_at(optimum.values)), graph, optimum.values)
        self._before = chain.drive if self._before is None else self._before
        return chain

    def _solve(self, loops: list[Loop]) -> tuple[PoseGraph, Optimum]:
        """Returns the graph with the given loops and its optimum.

        The latest optimum is kept, since the next step often needs it. If it contains loops, the next optimisation starts
        from it. Otherwise the graph's starting values are better: the first loops move the trajectory far, and the optimiser
        takes fewer steps from there.
        """
        if self._latest is None or [*map(id, loops)] != [*map(id, self._latest[0])]:
            start = self._latest[2].values if self._latest is not None and self._latest[0] else None
            self._latest = loops, *self._problem.optimise(loops, start=start)
        return self._latest[1:]


def find_loops(
    scans: Scans,
    problem: GraphProblem,
    estimator: EstimatorConfig,
    beam: Beam,
    runner: Runner,
    *,
    recognising: bool = True,
) -> LoopSearch:
    """Searches for the loops of a run with a `LoopCloser`.

    Loops found by recognition correct the trajectory, so that the search around it reaches further places. Search and
    recognition alternate, at most `ROUNDS` times, until no place is out of reach or recognition adds no loop.

    Args:
        scans: scans of the recording.
        problem: the trajectory to which loops are added.
        estimator: settings of the score.
        beam: the sensor's measurement errors.
        runner: gives the engine that compares scans, and reports progress.
        recognising: whether places out of reach of the search around the trajectory are recognised by their appearance.

    Raises:
        EstimationError: the uncertainty of the trajectory cannot be computed.
    """
    closer = LoopCloser(problem, lambda poses: TrackedRun.of(scans, poses), estimator, beam, runner)
    for _ in range(ROUNDS):
        closer.look_around()
        if not (recognising and closer.look_everywhere()):
            break
    return closer.conclude()
