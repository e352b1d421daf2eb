"""Two passes of one place: which revolutions may be such, how far apart to look, when to believe what was found.

Loop closures ask this to tie a trajectory, an audit to judge one; the settings of both name the same things.
"""

from __future__ import annotations

from collections.abc import Set
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam.backend.loops.align import Alignment
from mqslam.backend.loops.submap import spaced
from mqslam.core import se2

_STRICTER = 20.0  # a tried pair covers its earlier pass for least_path_m of path, the later one for this times less


class PassSettings(Protocol):
    """What `LoopConfig` and `AuditConfig` have in common; units and reasons stand there."""

    @property
    def spacing_m(self) -> float: ...
    @property
    def least_path_m(self) -> float: ...
    @property
    def reach_m(self) -> float: ...
    @property
    def drift(self) -> float: ...
    @property
    def drift_rad(self) -> float: ...
    @property
    def search_m(self) -> float: ...
    @property
    def search_rad(self) -> float: ...
    @property
    def gate_m(self) -> float: ...
    @property
    def gate_rad(self) -> float: ...
    @property
    def matched(self) -> float: ...
    @property
    def rival(self) -> float: ...


def pairs_of_passes(
    travelled: NDArray[np.float64],
    poses: se2.Array,
    settings: PassSettings,
    passes: int = 1,
    tried: Set[tuple[int, int]] = frozenset(),
) -> list[tuple[int, int]]:
    """Pairs (earlier, later) of poses that may show one place, nearest first per earlier pass.

    Two poses are a candidate where they lie within the sensor's reach of a common view plus what the trajectory may have
    drifted on the way from one to the other. Only the nearest pose of the nearest earlier passes is taken, and none where
    a neighbouring pair has been tried.

    Args:
        travelled: (N,) length of the path so far [m].
        poses: (N, 3).
        settings: how far to look.
        passes: earlier passes a pose is paired with.
        tried: pairs that are not taken again.
    """
    nodes = spaced(travelled, settings.spacing_m)
    paths = np.array([(travelled[a], travelled[b] * _STRICTER) for a, b in sorted(tried)])
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
        groups = _passes(near[fits], settings.least_path_m / settings.spacing_m)
        nearest = [group[np.argmin(np.hypot(*(xy[group] - place).T))] for group in groups]
        nearest.sort(key=lambda a: float(np.hypot(*(xy[a] - place))))
        for a in nearest[:passes]:
            if not known.query_ball_point([travelled[a], travelled[b] * _STRICTER], settings.least_path_m):
                pairs.append((int(nodes[a]), int(nodes[b])))
    return pairs


def reach(path_m: float, settings: PassSettings) -> tuple[float, float]:
    """How far the relative pose of two passes may be off [m], [rad] after a way round of path_m [m]."""
    return (
        min(settings.search_m + settings.drift * path_m, settings.gate_m),
        min(settings.search_rad + settings.drift_rad * path_m, settings.gate_rad),
    )


def unrivalled(found: Alignment, settings: PassSettings) -> bool:
    """Whether two passes hold every direction, lie on each other well enough, and fit nowhere else as well."""
    return found.observed and found.matched >= settings.matched and found.psi * settings.rival <= found.rival


def _passes(nodes: NDArray[np.int64], gap: float) -> list[NDArray[np.int64]]:
    """Increasing node indices split where they jump: every part is one earlier pass."""
    if len(nodes) == 0:
        return []
    return list(np.split(nodes, np.flatnonzero(np.diff(nodes) > gap) + 1))
