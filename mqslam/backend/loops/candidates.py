"""Candidates of loops: pairs of scans that may show one place, by what the graph says about their relative pose."""

from __future__ import annotations

from collections.abc import Set as AbstractSet
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.backend.loops.chain import Chain, Relative
from mqslam.backend.loops.layout import Layout, compute_layouts
from mqslam.backend.loops.passes import find_passes
from mqslam.config import LoopConfig

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
    layout: Layout


def find_candidates(
    chain: Chain, settings: LoopConfig, tried: AbstractSet[tuple[int, int]], groups: NDArray[np.int64] | None = None
) -> tuple[list[Candidate], list[tuple[int, int]]]:
    """Finds pairs of scans that may show one place.

    A pair is a candidate if its scans are no farther apart than two passes may be to see the same things, plus what the
    trajectory may be wrong between them. Only the nearest scan of each of the nearest earlier passes is taken, and none
    if a neighbouring pair has been tried.

    Args:
        chain: the trajectory, with its uncertainty.
        settings: of loops.
        tried: pairs that are not taken again.
        groups: (N,) group of each scan, if only pairs of different groups are wanted.

    Returns:
        candidates, and pairs that cannot be compared because the trajectory is less sure of them than the search reaches.

    Raises:
        EstimationError: the uncertainty cannot be computed.
    """
    widest_m = settings.reach_m + settings.gate_m
    drive = chain.drive
    passes = find_passes(drive.travelled, drive.poses, settings, lambda path_m: np.full_like(path_m, widest_m))
    if groups is not None:
        passes = [[(a, b) for a, b in nearest if groups[a] != groups[b]] for nearest in passes]
    pairs = [pair for nearest in passes for pair in nearest]
    relatives = dict(zip(pairs, chain.relate(pairs), strict=True))
    known = _Tried(tried, drive.travelled, settings)
    found, unsure = [], []
    for nearest in passes:
        near = [pair for pair in nearest if may_meet(relatives[pair], settings)]
        for pair in near[: settings.passes]:
            reach_m, reach_rad = compute_reach(relatives[pair], settings)
            if known.covers(pair):
                continue
            if reach_m > settings.gate_m or reach_rad > settings.gate_rad:
                unsure.append(pair)
            else:
                found.append((pair, reach_m, reach_rad))
    layouts = compute_layouts(chain, [pair for pair, _, _ in found], settings)
    candidates = [
        Candidate(*pair, reach_m, reach_rad, relatives[pair], layout)
        for (pair, reach_m, reach_rad), layout in zip(found, layouts, strict=True)
    ]
    return candidates, unsure


def compute_reach(relative: Relative, settings: LoopConfig) -> tuple[float, float]:
    """Returns how far the relative pose of two passes may be off [m], [rad]."""
    sigma_m = float(np.sqrt(np.linalg.eigvalsh(relative.covariance[:2, :2])[-1]))
    sigma_rad = float(np.sqrt(relative.covariance[2, 2]))
    return max(settings.search_m, settings.sigmas * sigma_m), max(settings.search_rad, settings.sigmas * sigma_rad)


def may_meet(relative: Relative, settings: LoopConfig, slack_m: float = 0.0) -> bool:
    """Returns whether two scans, or others up to slack_m [m] beside them, may lie near enough to show one place."""
    apart = relative.motion[:2]
    distance = float(np.hypot(*apart))
    if distance <= settings.reach_m + slack_m:
        return True
    towards = apart / distance
    sigma = float(np.sqrt(towards @ relative.covariance[:2, :2] @ towards))
    return distance <= settings.reach_m + slack_m + settings.sigmas * sigma


class _Tried:
    """The pairs of scans that have been compared, of which neighbours are not compared again.

    Args:
        tried: the pairs.
        travelled: (N,) length of the path so far [m].
        settings: of loops.
    """

    def __init__(self, tried: AbstractSet[tuple[int, int]], travelled: NDArray[np.float64], settings: LoopConfig) -> None:
        self._travelled, self._settings = travelled, settings
        self._tree = cKDTree(np.array([self._place(pair) for pair in sorted(tried)]).reshape(-1, 2))

    def covers(self, pair: tuple[int, int]) -> bool:
        """Returns whether a neighbour of the pair is among them."""
        return bool(self._tree.query_ball_point(self._place(pair), self._settings.least_path_m))

    def _place(self, pair: tuple[int, int]) -> tuple[float, float]:
        """Returns where on the path the two scans lie, the later one's place stretched."""
        return float(self._travelled[pair[0]]), float(self._travelled[pair[1]]) * _TRIED_FACTOR
