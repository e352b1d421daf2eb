"""Loop closures of a drive: candidates from its own uncertainty, verified by psi."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mqslam.backend.loops.align import align, cross_score
from mqslam.backend.loops.passes import pairs_of_passes, reach, unrivalled
from mqslam.backend.loops.submap import Drive, submap
from mqslam.config import EstimatorConfig, LoopConfig
from mqslam.core import se2
from mqslam.core.measurement import Loop
from mqslam.execution.engine import Engine
from mqslam.execution.progress import Progress
from mqslam.psi.place import Beam, PointSet


def find_loops(
    drive: Drive,
    settings: LoopConfig,
    estimator: EstimatorConfig,
    beam: Beam,
    tried: set[tuple[int, int]],
    engine: Engine,
    progress: Progress,
) -> list[Loop]:
    """Loops of a drive, each verified by psi on its own.

    Args:
        drive: scans under the best trajectory so far.
        settings: of loops.
        estimator: settings of the score.
        beam: the sensor's errors.
        tried: pairs that are not tried again; those of this search are added.
        engine: where they are verified; the result does not depend on it.
        progress: called as candidates are verified.
    """
    pairs = candidate_pairs(drive, settings, tried)
    tried.update(pairs)

    def done(number: int, loop: Loop | None) -> None:
        progress("loops", number, len(pairs))

    verified = engine.map(_verified, (drive, settings, estimator, beam), pairs, done)
    return [loop for loop in verified if loop is not None]


def candidate_pairs(drive: Drive, settings: LoopConfig, tried: set[tuple[int, int]]) -> list[tuple[int, int]]:
    """Pairs (earlier, later) of revolutions that may show one place, as `passes.pairs_of_passes` finds them."""
    return pairs_of_passes(drive.travelled, drive.poses, settings, settings.passes, tried)


def gate(drive: Drive, earlier: int, later: int, settings: LoopConfig) -> tuple[float, float]:
    """How far two revolutions' relative pose may be off [m], [rad]."""
    return reach(float(drive.travelled[later] - drive.travelled[earlier]), settings)


def _verified(shared: tuple[Drive, LoopConfig, EstimatorConfig, Beam], pair: tuple[int, int]) -> Loop | None:
    drive, settings, estimator, beam = shared
    earlier, later = pair
    reference, query = _submaps(drive, earlier, later, settings, beam)
    if len(reference) < settings.fewest or len(query) < settings.fewest:
        return None
    guess = se2.between(drive.poses[earlier], drive.poses[later])
    found = align(reference, query, guess, *gate(drive, earlier, later, settings), estimator)
    sure = np.sqrt(np.diag(found.covariance))
    if not unrivalled(found, settings) or max(sure[0], sure[1]) > settings.sure_m:
        return None
    return Loop(earlier, later, found.pose, found.covariance, found.matched, found.psi)


def kept_by_map(
    loops: Sequence[Loop],
    drive: Drive,
    after: se2.Array,
    settings: LoopConfig,
    estimator: EstimatorConfig,
    beam: Beam,
    engine: Engine,
) -> list[Loop]:
    """The loops with which the map of their own two passes is better than without.

    Args:
        drive: scans under the trajectory before the loops.
        after: (N, 3) poses with the loops.
        settings: of loops.
        estimator: settings of the score.
        beam: the sensor's errors.
        engine: where they are judged; the result does not depend on it.
    """
    better = engine.map(_improves, (drive, after, settings, estimator, beam), loops)
    return [loop for loop, keep in zip(loops, better, strict=True) if keep]


def _improves(shared: tuple[Drive, se2.Array, LoopConfig, EstimatorConfig, Beam], loop: Loop) -> bool:
    """Whether psi of the two passes is lower than before, or about as low as it was and as it can be."""
    drive, after, settings, estimator, beam = shared
    reference, query = _submaps(drive, loop.earlier, loop.later, settings, beam)
    before_psi, after_psi = (
        cross_score(reference, query, se2.between(poses[loop.earlier], poses[loop.later]), estimator)
        for poses in (drive.poses, after)
    )
    return after_psi < before_psi or after_psi <= settings.kept * min(before_psi, loop.psi)


def _submaps(drive: Drive, earlier: int, later: int, settings: LoopConfig, beam: Beam) -> tuple[PointSet, PointSet]:
    """The earlier pass, and the smaller part of the later one that is laid into it."""
    reach, spacing = settings.submap_m, settings.spacing_m
    return submap(drive, earlier, reach, spacing, beam), submap(drive, later, 0.5 * reach, spacing, beam)
