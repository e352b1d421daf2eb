"""Revisits: where a trajectory comes back to a place, and how far psi says that the two passes are off each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.laying import lay
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.verdict import Share
from mqslam.auditing.windows import torn_threshold
from mqslam.backend.loops.passes import find_passes
from mqslam.backend.loops.submap import pick_around
from mqslam.config import AuditConfig, EstimatorConfig, LoopConfig
from mqslam.core import se2
from mqslam.execution.engine import Engine
from mqslam.execution.progress import Progress


@dataclass(frozen=True, slots=True)
class Revisit:
    """Two passes of one place.

    Args:
        earlier, later: the two sweeps.
        offset: (3,) where psi has the later pass against where the trajectory has it, in the frame of the later sweep
            [m, m, rad].
        covariance: (3, 3) of the offset.
        inflation: offset^T covariance^-1 offset.
        matched: share of the later pass's points that lie on the earlier one's.
        psi, psi_best: score per point as the trajectory has it and with the offset corrected.
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


@dataclass(frozen=True, slots=True)
class RevisitAudit:
    """The judgement of one revisit.

    Args:
        revisit: the two passes and their offset.
        torn: whether they are off each other beyond what the covariance explains and beyond the settings' tolerance.
    """

    revisit: Revisit
    torn: bool


def audit_revisits(
    sweeps: Sweeps,
    settings: AuditConfig,
    estimator: EstimatorConfig,
    loops: LoopConfig,
    engine: Engine,
    progress: Progress,
) -> list[RevisitAudit]:
    """Judges the revisits of a map; those of which either pass holds too few points are left out.

    Args:
        sweeps: points under the trajectory to judge.
        settings: of the audit.
        estimator: settings of the score.
        loops: settings of loops, whose floor holds for revisits too.
        engine: where the revisits are judged; the result does not depend on it.
        progress: called as revisits are done.
    """
    pairs = find_revisit_pairs(sweeps, settings)

    def report(number: int, revisit: Revisit | None) -> None:
        progress("revisits", number, len(pairs))

    revisits = engine.map(_measure_pair, (sweeps, settings, estimator, loops), pairs, report)
    return [RevisitAudit(revisit, is_torn(revisit, settings)) for revisit in revisits if revisit is not None]


def share_torn_revisits(revisits: Sequence[RevisitAudit]) -> Share:
    """Returns the share of torn revisits among those that are sure."""
    sure = [revisit for revisit in revisits if revisit.revisit.sure]
    return Share(sum(revisit.torn for revisit in sure), len(sure))


def find_revisit_pairs(sweeps: Sweeps, settings: AuditConfig) -> list[tuple[int, int]]:
    """Finds pairs (earlier, later) of sweeps that may show one place: the nearest earlier pass every spacing_m of path."""
    passes = find_passes(
        sweeps.travelled,
        sweeps.poses,
        settings,
        lambda path_m: np.minimum(settings.reach_m + settings.drift * path_m, settings.gate_m),
    )
    return [nearest[0] for nearest in passes if nearest]


def compute_reach(path_m: float, settings: AuditConfig) -> tuple[float, float]:
    """Returns how far the relative pose of two passes may be off [m], [rad] after path_m [m] of path between them."""
    position_m = min(settings.search_m + settings.drift * path_m, settings.gate_m)
    yaw = min(settings.search_rad + settings.drift_rad * path_m, settings.gate_rad)
    return position_m, yaw


def _measure_pair(shared: tuple[Sweeps, AuditConfig, EstimatorConfig, LoopConfig], pair: tuple[int, int]) -> Revisit | None:
    """Lays one pass of a pair on the other."""
    sweeps, settings, estimator, loops = shared
    return measure_revisit(sweeps, *pair, settings, estimator, loops)


def measure_revisit(
    sweeps: Sweeps, earlier: int, later: int, settings: AuditConfig, estimator: EstimatorConfig, loops: LoopConfig
) -> Revisit | None:
    """Lays one pass on the other; returns None where either holds too few points.

    Args:
        sweeps: points under the trajectory to judge.
        earlier: sweep of the earlier pass.
        later: sweep of the later pass.
        settings: of the audit.
        estimator: settings of the score.
        loops: settings of loops, whose floor holds here too, because submaps bend.
    """
    path_m = float(sweeps.travelled[later] - sweeps.travelled[earlier])
    passes, reach = pick_passes(sweeps, earlier, later, settings), compute_reach(path_m, settings)
    laid = lay(sweeps, (earlier, later), passes, reach, settings, estimator)
    if laid is None:
        return None
    covariance = laid.covariance + np.diag([loops.floor_m**2, loops.floor_m**2, loops.floor_rad**2])
    return Revisit(
        earlier=earlier,
        later=later,
        offset=laid.offset,
        covariance=covariance,
        inflation=float(laid.offset @ np.linalg.solve(covariance, laid.offset)),
        matched=laid.matched,
        psi=laid.psi,
        psi_best=laid.psi_best,
        sure=laid.unrivalled,
    )


def is_torn(revisit: Revisit, settings: AuditConfig) -> bool:
    """Returns whether two passes are off each other."""
    beyond = revisit.inflation > torn_threshold(settings)
    far = revisit.distance_m > settings.torn_m or abs(revisit.offset[2]) > settings.torn_rad
    return bool(revisit.sure and beyond and far)


def pick_passes(sweeps: Sweeps, earlier: int, later: int, settings: AuditConfig) -> tuple[list[int], list[int]]:
    """Returns the sweeps of the earlier pass, and of the smaller part of the later one that is laid on it."""
    first, second = (
        pick_around(sweeps.travelled, k, reach_m, settings.submap_spacing_m).tolist()
        for k, reach_m in ((earlier, settings.submap_m), (later, settings.later_share * settings.submap_m))
    )
    return first, second
