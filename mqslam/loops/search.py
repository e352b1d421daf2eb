"""Loop closures of a drive: candidates from its own uncertainty, verified by psi."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam import se2
from mqslam.config import Config
from mqslam.detection import Progress
from mqslam.loops.align import align, cross_score
from mqslam.loops.submap import Drive, submap


@dataclass(frozen=True, slots=True)
class Loop:
    """A place passed twice.

    Args:
        earlier, later: indices of the two revolutions.
        pose: (3,) of the later one in the frame of the earlier.
        covariance: (3, 3) of it [m, m, rad].
        matched: share of the later pass's returns that lie on the earlier one's.
        psi: score per point of the two passes laid on each other.
    """

    earlier: int
    later: int
    pose: se2.Array
    covariance: NDArray[np.float64]
    matched: float
    psi: float


def find_loops(
    drive: Drive, config: Config, done: Sequence[Loop], jobs: int, progress: Progress
) -> tuple[list[Loop], int]:
    """Loops of a drive besides those found already.

    Args:
        drive: windows under the best trajectory so far.
        config: all settings.
        done: loops found before; their pairs are not tried again.
        jobs: threads that verify.
        progress: called as candidates are verified.

    Returns:
        loops that passed, and how many candidates did not.
    """
    pairs = candidate_pairs(drive, config, {(loop.earlier, loop.later) for loop in done})

    def verify(pair: tuple[int, int]) -> Loop | None:
        return _verified(drive, *pair, config)

    found: list[Loop] = []
    with ThreadPoolExecutor(jobs) as pool:
        for number, loop in enumerate(pool.map(verify, pairs), 1):
            if loop is not None:
                found.append(loop)
            progress("loops", number, len(pairs))
    return found, len(pairs) - len(found)


def candidate_pairs(drive: Drive, config: Config, done: set[tuple[int, int]]) -> list[tuple[int, int]]:
    """Pairs (earlier, later) of revolutions that may show one place, nearest first per earlier pass.

    Two revolutions are a candidate where they lie within the radar's reach of a common view plus what the trajectory may
    have drifted on the way from one to the other. Of each earlier pass only the nearest revolution is taken.
    """
    settings = config.loops
    nodes = drive.spaced(settings.spacing_m)
    travelled, xy = drive.travelled[nodes], drive.poses[nodes, :2]
    tree = cKDTree(xy)
    widest = settings.reach_m + settings.drift * float(travelled[-1])
    pairs = []
    for b, place in enumerate(xy):
        near = np.array(sorted(a for a in tree.query_ball_point(place, min(widest, settings.gate_m)) if a < b), dtype=int)
        path = travelled[b] - travelled[near]
        apart = np.hypot(*(xy[near] - place).T)
        fits = (path > settings.least_path_m) & (apart <= settings.reach_m + settings.drift * path)
        for group in _passes(near[fits], settings.least_path_m / settings.spacing_m):
            a = group[np.argmin(np.hypot(*(xy[group] - place).T))]
            pair = (int(nodes[a]), int(nodes[b]))
            if pair not in done:
                pairs.append(pair)
    return pairs


def _passes(nodes: NDArray[np.int64], gap: float) -> list[NDArray[np.int64]]:
    """Increasing node indices split where they jump: every part is one earlier pass."""
    if len(nodes) == 0:
        return []
    return list(np.split(nodes, np.flatnonzero(np.diff(nodes) > gap) + 1))


def gate(drive: Drive, earlier: int, later: int, config: Config) -> tuple[float, float]:
    """How far two revolutions' relative pose may be off [m], [rad]."""
    settings = config.loops
    path = drive.travelled[later] - drive.travelled[earlier]
    return (
        min(settings.search_m + settings.drift * path, settings.gate_m),
        min(settings.search_rad + settings.drift_rad * path, settings.gate_rad),
    )


def _verified(drive: Drive, earlier: int, later: int, config: Config) -> Loop | None:
    settings = config.loops
    reference = submap(drive, earlier, settings.submap_m, settings.spacing_m, config)
    query = submap(drive, later, 0.5 * settings.submap_m, settings.spacing_m, config)
    if len(reference) < settings.fewest or len(query) < settings.fewest:
        return None
    guess = se2.between(drive.poses[earlier], drive.poses[later])
    found = align(reference, query, guess, *gate(drive, earlier, later, config), config.estimator)
    sure = np.sqrt(np.diag(found.covariance))
    if not (
        found.observed
        and found.matched >= settings.matched
        and found.psi * settings.rival <= found.rival
        and max(sure[0], sure[1]) <= settings.sure_m
    ):
        return None
    return Loop(earlier, later, found.pose, found.covariance, found.matched, found.psi)


def improves_map(
    loop: Loop, windows_drive: Drive, before: se2.Array, after: se2.Array, config: Config
) -> bool:
    """Whether the map of the two passes is better under the optimised poses than before, and as good as the loop's own.

    Args:
        windows_drive: the drive the submaps are rendered from.
        before, after: (N, 3) poses without and with loops.
    """
    settings = config.loops
    reference = submap(windows_drive, loop.earlier, settings.submap_m, settings.spacing_m, config)
    query = submap(windows_drive, loop.later, 0.5 * settings.submap_m, settings.spacing_m, config)
    scores = [
        cross_score(reference, query, se2.between(poses[loop.earlier], poses[loop.later]), config.estimator)
        for poses in (before, after)
    ]
    return scores[1] <= scores[0] + 1e-9 or scores[1] <= settings.kept * loop.psi
