"""Revisits: where a trajectory comes back to a place, how far the two passes are off each other, by psi."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.audit.sweeps import Sweeps
from mqslam.backend.loops.align import align, cross_score
from mqslam.backend.loops.passes import pairs_of_passes, reach, unrivalled
from mqslam.backend.loops.submap import around
from mqslam.config import AuditConfig, EstimatorConfig, LoopConfig
from mqslam.core import se2


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
    return pairs_of_passes(sweeps.travelled, sweeps.poses, settings)


def revisit(
    sweeps: Sweeps, earlier: int, later: int, settings: AuditConfig, estimator: EstimatorConfig, loops: LoopConfig
) -> Revisit | None:
    """Lay one pass on the other; None where either holds too few points.

    Args:
        sweeps: points under the trajectory to judge.
        earlier, later: the two sweeps.
        settings: of the audit.
        estimator: settings of the score.
        loops: whose floor holds here too: submaps bend.
    """
    chosen = passes_of(sweeps, earlier, later, settings)
    reference, query = (sweeps.local(part, sweeps.poses[k]) for part, k in zip(chosen, (earlier, later), strict=True))
    if min(len(reference), len(query)) < settings.fewest:
        return None
    guess = se2.between(sweeps.poses[earlier], sweeps.poses[later])
    path_m = float(sweeps.travelled[later] - sweeps.travelled[earlier])
    found = align(reference, query, guess, *reach(path_m, settings), estimator)
    offset = se2.wrapped_between(guess, found.pose)
    floor = np.diag([loops.floor_m**2, loops.floor_m**2, loops.floor_rad**2])
    covariance = se2.turned(found.covariance, -guess[2]) + floor
    return Revisit(
        earlier,
        later,
        offset,
        covariance,
        float(offset @ np.linalg.solve(covariance, offset)),
        found.matched,
        cross_score(reference, query, guess, estimator),
        found.psi,
        unrivalled(found, settings),
    )


def passes_of(sweeps: Sweeps, earlier: int, later: int, settings: AuditConfig) -> tuple[list[int], list[int]]:
    """The sweeps of the earlier pass, and of the smaller part of the later one that is laid on it."""
    first, second = (
        around(sweeps.travelled, k, reach_m, settings.submap_spacing_m).tolist()
        for k, reach_m in ((earlier, settings.submap_m), (later, 0.5 * settings.submap_m))
    )
    return first, second
