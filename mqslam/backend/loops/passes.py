"""Two passes of one place: which scans may be such, how far to search, and when a match is believed.

Loop closures ask this to correct a trajectory, an audit to judge one. The constants are those of loop closures; an audit has
settings of its own in their place, since anyone may have made the trajectory that it judges.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.backend.loops.align import RIVAL, Alignment
from mqslam.core import se2
from mqslam.mapping.keyframing import pick_spaced

# Two scans with less path between them [m] are not two passes: odometry ties them already.
LEAST_PATH_M = 60.0
# Least share of the later pass's returns that must lie on the earlier pass.
MATCHED = 0.45


def find_passes(
    travelled: NDArray[np.float64],
    poses: se2.Array,
    spacing_m: float,
    least_path_m: float,
    reach_m: Callable[[NDArray[np.float64]], NDArray[np.float64]],
) -> list[list[tuple[int, int]]]:
    """Finds, for poses a certain path apart, pairs (earlier, later) with the nearest pose of every earlier pass.

    Args:
        travelled: (N,) length of the path so far [m].
        poses: (N, 3).
        spacing_m: path [m] between the poses for which earlier passes are looked for.
        least_path_m: path [m] between two poses, from which on they are different passes.
        reach_m: returns how far apart two poses may lie [m], given the path between them [m]; it never falls.

    Returns:
        pairs of each later pose, the nearest pass first.
    """
    nodes = pick_spaced(travelled, spacing_m)
    travelled, xy = travelled[nodes], poses[nodes, :2]
    tree = cKDTree(xy)
    widest_m = float(reach_m(travelled[-1:])[0])
    passes = []
    for b, place in enumerate(xy):
        near = np.array(sorted(a for a in tree.query_ball_point(place, widest_m) if a < b), dtype=int)
        path = travelled[b] - travelled[near]
        apart = np.hypot(*(xy[near] - place).T)
        groups = _split_passes(near[(path > least_path_m) & (apart <= reach_m(path))], least_path_m / spacing_m)
        nearest = [group[np.argmin(np.hypot(*(xy[group] - place).T))] for group in groups]
        nearest.sort(key=lambda a: float(np.hypot(*(xy[a] - place))))
        passes.append([(int(nodes[a]), int(nodes[b])) for a in nearest])
    return passes


def is_unrivalled(alignment: Alignment, matched: float) -> bool:
    """Returns whether two passes hold every direction, lie on each other well enough, and fit nowhere else as well.

    Args:
        alignment: of the two passes.
        matched: least share of the later pass's returns that must lie on the earlier pass.
    """
    return does_match(alignment, matched) and alignment.psi * RIVAL <= alignment.rival


def does_match(alignment: Alignment, matched: float) -> bool:
    """Returns whether two passes hold every direction and lie on each other well enough; arguments as `is_unrivalled`."""
    return alignment.observed and alignment.matched >= matched


def _split_passes(nodes: NDArray[np.int64], gap: float) -> list[NDArray[np.int64]]:
    """Splits increasing node indices where they jump by more than a gap: every part is one earlier pass."""
    if len(nodes) == 0:
        return []
    return list(np.split(nodes, np.flatnonzero(np.diff(nodes) > gap) + 1))
