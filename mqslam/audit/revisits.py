"""Revisits: where a trajectory comes back to a place, how far the two passes are off each other, by psi."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mqslam import se2
from mqslam.audit.settings import AuditConfig
from mqslam.audit.sweeps import Sweeps
from mqslam.config import Config
from mqslam.loops.align import Alignment, align, cross_score
from mqslam.loops.submap import around, spaced
from mqslam.psi.place import PointSet


@dataclass(frozen=True, slots=True)
class Revisit:
    """Two passes of one place.

    Args:
        earlier, later: the two sweeps.
        offset: (3,) where psi has the later pass against where the trajectory has it, in the frame of the later sweep
            [m, m, rad].
        covariance: (3, 3) of it.
        inflation: offset^T covariance^-1 offset.
        matched: share of the later pass's points that lie on the earlier one's.
        psi, psi_best: score per point as the trajectory has it and with the offset mended.
        sure: whether the maps of the two passes fit nowhere else as well and hold every direction.
    """

    earlier: int
    later: int
    offset: se2.Array
    covariance: NDArray[np.float64]
    inflation: float
    matched: float
    psi: float
    psi_best: float
    sure: bool

    @property
    def distance_m(self) -> float:
        """How far the passes are apart [m]."""
        return float(np.hypot(self.offset[0], self.offset[1]))


def revisit_pairs(sweeps: Sweeps, settings: AuditConfig) -> list[tuple[int, int]]:
    """Pairs (earlier, later) of sweeps that may show one place, every spacing_m of path: the nearest earlier pass."""
    nodes = spaced(sweeps.travelled, settings.spacing_m)
    travelled, xy = sweeps.travelled[nodes], sweeps.poses[nodes, :2]
    tree = cKDTree(xy)
    widest = min(settings.reach_m + settings.drift * float(travelled[-1]), settings.gate_m)
    pairs = []
    for b, place in enumerate(xy):
        near = np.array([a for a in tree.query_ball_point(place, widest) if a < b], dtype=np.int64)
        path = travelled[b] - travelled[near]
        apart = np.hypot(*(xy[near] - place).T)
        fits = near[(path > settings.least_path_m) & (apart <= settings.reach_m + settings.drift * path)]
        if len(fits):
            a = fits[np.argmin(np.hypot(*(xy[fits] - place).T))]
            pairs.append((int(nodes[a]), int(nodes[b])))
    return pairs


def revisit(sweeps: Sweeps, earlier: int, later: int, config: Config) -> Revisit | None:
    """Lay one pass on the other; None where either holds too few points."""
    settings = config.audit
    reference, query = (
        _submap(sweeps, earlier, settings.submap_m, settings),
        _submap(sweeps, later, 0.5 * settings.submap_m, settings),
    )
    if min(len(reference), len(query)) < settings.fewest:
        return None
    guess = se2.between(sweeps.poses[earlier], sweeps.poses[later])
    path = sweeps.travelled[later] - sweeps.travelled[earlier]
    reach_m = min(settings.search_m + settings.drift * path, settings.gate_m)
    reach_rad = min(settings.search_rad + settings.drift_rad * path, settings.gate_rad)
    found = align(reference, query, guess, reach_m, reach_rad, config.estimator)
    offset = se2.between(guess, found.pose)
    offset[2] = se2.wrap(offset[2])
    c, s = np.cos(guess[2]), np.sin(guess[2])
    to_later = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    floor = np.diag([config.loops.floor_m**2, config.loops.floor_m**2, config.loops.floor_rad**2])
    covariance = to_later @ found.covariance @ to_later.T + floor
    return Revisit(
        earlier, later, offset, covariance, float(offset @ np.linalg.solve(covariance, offset)), found.matched,
        cross_score(reference, query, guess, config.estimator), found.psi, _sure(found, settings),
    )  # fmt: skip


def _sure(found: Alignment, settings: AuditConfig) -> bool:
    return found.observed and found.matched >= settings.matched and found.psi * settings.rival <= found.rival


def _submap(sweeps: Sweeps, centre: int, reach_m: float, settings: AuditConfig) -> PointSet:
    """Points of the sweeps within reach_m of path around one, in its frame."""
    chosen = around(sweeps.travelled, centre, reach_m, settings.submap_spacing_m)
    return sweeps.local(chosen.tolist(), sweeps.poses[centre])
