"""Two passes of one place: which scans may be such, how far to search, and when a match is believed.

Loop closures ask this to correct a trajectory, an audit to judge one; their settings derive from the same class.
"""

from __future__ import annotations

from collections.abc import Set

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.backend.loops.align import Alignment
from mqslam.backend.loops.submap import pick_spaced
from mqslam.config import PassConfig
from mqslam.core import se2


def find_pass_pairs(
    travelled: NDArray[np.float64],
    poses: se2.Array,
    settings: PassConfig,
    passes: int = 1,
    tried: Set[tuple[int, int]] = frozenset(),
) -> list[tuple[int, int]]:
    """Finds pairs (earlier, later) of poses that may show one place, the nearest earlier pass first.

    Two poses are a candidate if they are no farther apart than two passes may be to see the same things, plus the drift
    of the trajectory on the way from one to the other. Only the nearest pose of each of the nearest earlier passes is
    taken, and none if a neighbouring pair has been tried.

    Args:
        travelled: (N,) length of the path so far [m].
        poses: (N, 3).
        settings: how far to look.
        passes: number of earlier passes that a pose is paired with.
        tried: pairs that are not taken again.
    """
    nodes = pick_spaced(travelled, settings.spacing_m)
    paths = np.array([(travelled[a], travelled[b] * settings.tried_factor) for a, b in sorted(tried)])
    known = cKDTree(paths.reshape(-1, 2))
    travelled, xy = travelled[nodes], poses[nodes, :2]
    tree = cKDTree(xy)
    widest = settings.reach_m + settings.drift * float(travelled[-1])
    pairs = []
    for b, place in enumerate(xy):
        near = np.array(sorted(a for a in tree.query_ball_point(place, min(widest, settings.gate_m)) if a < b), dtype=int)
        path = travelled[b] - travelled[near]
        apart = np.hypot(*(xy[near] - place).T)
        fits = (path > settings.least_path_m) & (apart <= settings.reach_m + settings.drift * path)
        groups = _split_passes(near[fits], settings.least_path_m / settings.spacing_m)
        nearest = [group[np.argmin(np.hypot(*(xy[group] - place).T))] for group in groups]
        nearest.sort(key=lambda a: float(np.hypot(*(xy[a] - place))))
        for a in nearest[:passes]:
            if not known.query_ball_point([travelled[a], travelled[b] * settings.tried_factor], settings.least_path_m):
                pairs.append((int(nodes[a]), int(nodes[b])))
    return pairs


def compute_reach(path_m: float, settings: PassConfig) -> tuple[float, float]:
    """Returns how far the relative pose of two passes may be off [m], [rad] after path_m [m] of path between them."""
    position_m = min(settings.search_m + settings.drift * path_m, settings.gate_m)
    yaw = min(settings.search_rad + settings.drift_rad * path_m, settings.gate_rad)
    return position_m, yaw


def is_unrivalled(alignment: Alignment, settings: PassConfig) -> bool:
    """Returns whether two passes hold every direction, lie on each other well enough, and fit nowhere else as well."""
    matched = alignment.matched >= settings.matched
    return alignment.observed and matched and alignment.psi * settings.rival <= alignment.rival


def _split_passes(nodes: NDArray[np.int64], gap: float) -> list[NDArray[np.int64]]:
    """Splits increasing node indices where they jump by more than a gap: every part is one earlier pass."""
    if len(nodes) == 0:
        return []
    return list(np.split(nodes, np.flatnonzero(np.diff(nodes) > gap) + 1))
