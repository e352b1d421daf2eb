"""Candidates of loops: pairs of scans that may show one place, by what the graph says about their relative pose."""

from __future__ import annotations

from collections.abc import Set as AbstractSet
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.backend.loops import passes
from mqslam.backend.loops.chain import Chain, Relative, SubmapLayout, compute_layouts
from mqslam.backend.loops.submap import SPACING_M

# Distance [m] at which two passes still see the same things.
_REACH_M = 12.0
# Least half width of the search for the later pass's position [m]. It is wider than most trajectories need: a street that
# repeats shows it within that distance, whatever the trajectory says.
_SEARCH_M = 15.0
# Least half width of the search in yaw [rad].
_SEARCH_RAD = 0.03
# Largest half width of the search for the later pass's position [m], which bounds its time.
GATE_M = 40.0
# Largest half width of the search in yaw [rad], which bounds its time.
_GATE_RAD = 0.3
# The search reaches as far as this many standard deviations of what the trajectory says about the pose of one pass relative
# to the other. Where that is beyond GATE_M or _GATE_RAD, the passes are not compared.
_SIGMAS = 3.0
# Number of earlier passes, the nearest first, that a scan is tied to.
_PASSES = 1
# Once a pair of passes is compared, no pair is compared whose earlier scan lies within least_path_m of this pair's, and
# whose later scan lies within that path divided by this.
_TRIED_FACTOR = 20.0


class Candidate(NamedTuple):
    """A pair of scans that may show one place.

    Args:
        earlier, later: indices of the two scans.
        reach_m: how far the search for the later scan must look around where the trajectory has it [m].
        reach_rad: the same in yaw [rad].
        chain: what the trajectory says about the later scan's pose in the frame of the earlier one.
        layout: what it leaves unsure about how the scans around either of them lie.
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

    A pair is a candidate if its scans are no farther apart than two passes may be to see the same things, plus what the
    trajectory may be wrong between them. Only the nearest scan of each of the nearest earlier passes is taken, and none
    if a neighbouring pair has been tried.

    Args:
        chain: the trajectory, with its uncertainty.
        tried: pairs that are not taken again.
        groups: (N,) group of each scan, if only pairs of different groups are wanted.

    Returns:
        candidates, and pairs that cannot be compared because the trajectory is less sure of them than the search reaches.

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
    known = _Tried(tried, drive.travelled, least_path_m)
    found, unsure = [], []
    for nearest in of_scans:
        near = [pair for pair in nearest if may_meet(relatives[pair])]
        for pair in near[:_PASSES]:
            reach_m, reach_rad = compute_reach(relatives[pair])
            if known.covers(pair):
                continue
            if is_beyond_gate(reach_m, reach_rad):
                unsure.append(pair)
            else:
                found.append((pair, reach_m, reach_rad))
    layouts = compute_layouts(chain, [pair for pair, _, _ in found])
    candidates = [
        Candidate(*pair, reach_m, reach_rad, relatives[pair], layout)
        for (pair, reach_m, reach_rad), layout in zip(found, layouts, strict=True)
    ]
    return candidates, unsure


def compute_reach(relative: Relative) -> tuple[float, float]:
    """Returns how far the relative pose of two passes may be off [m], [rad]."""
    sigma_m = float(np.sqrt(np.linalg.eigvalsh(relative.covariance[:2, :2])[-1]))
    sigma_rad = float(np.sqrt(relative.covariance[2, 2]))
    return max(_SEARCH_M, _SIGMAS * sigma_m), max(_SEARCH_RAD, _SIGMAS * sigma_rad)


def is_beyond_gate(reach_m: float, reach_rad: float) -> bool:
    """Returns whether a trajectory asks for a wider search, in position [m] or in yaw [rad], than is made."""
    return reach_m > GATE_M or reach_rad > _GATE_RAD


def may_meet(relative: Relative, slack_m: float = 0.0) -> bool:
    """Returns whether two scans, or others up to slack_m [m] beside them, may lie near enough to show one place."""
    apart = relative.motion[:2]
    distance = float(np.hypot(*apart))
    if distance <= _REACH_M + slack_m:
        return True
    towards = apart / distance
    sigma = float(np.sqrt(towards @ relative.covariance[:2, :2] @ towards))
    return distance <= _REACH_M + slack_m + _SIGMAS * sigma


class _Tried:
    """The pairs of scans that have been compared, of which neighbours are not compared again.

    Args:
        tried: the pairs.
        travelled: (N,) length of the path so far [m].
        least_path_m: path [m] within which the earlier scans of two pairs are neighbours.
    """

    def __init__(self, tried: AbstractSet[tuple[int, int]], travelled: NDArray[np.float64], least_path_m: float) -> None:
        self._travelled, self._least_path_m = travelled, least_path_m
        self._tree = cKDTree(np.array([self._place(pair) for pair in sorted(tried)]).reshape(-1, 2))

    def covers(self, pair: tuple[int, int]) -> bool:
        """Returns whether a neighbour of the pair is among them."""
        return bool(self._tree.query_ball_point(self._place(pair), self._least_path_m))

    def _place(self, pair: tuple[int, int]) -> tuple[float, float]:
        """Returns where on the path the two scans lie, the later one's place stretched."""
        return float(self._travelled[pair[0]]), float(self._travelled[pair[1]]) * _TRIED_FACTOR
