"""Two stretches of a map laid on each other: where psi has the later one, against where the trajectory has it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.sweeps import Sweeps
from mqslam.backend.loops.registration import RIVAL, align, is_unrivalled, score_at_pose
from mqslam.config import AuditConfig, EstimatorConfig
from mqslam.core import se2
from mqslam.psi.score import make_references

# Largest error of a trajectory's speed [m/s] that is looked for between two successive scans: more than any vehicle
# drives, so that a trajectory that stands still is found, too.
SPEED_ERROR_MPS = 50.0
# Two successive scans of which one has fewer points than this say nothing about the speed.
_SPEED_FEWEST = 40


@dataclass(frozen=True, slots=True)
class Registration:
    """Two stretches, the later one laid on the earlier one.

    Args:
        earlier, later: the sweeps in whose frames the stretches are laid.
        between: (3,) pose of the later one in the frame of the earlier one, as the trajectory has it.
        path_m: length of the path between the two [m].
        offset: (3,) where psi has the later stretch against where the trajectory has it, in the frame of the later sweep
            [m, m, rad].
        covariance: (3, 3) of the offset, as psi's curvature states it.
        centre, spread_m: mean (2,) of the points of the later stretch, in the frame of the later sweep, and root mean square
            of their distances from it [m].
        matched: share of these points that lie on the earlier stretch.
        psi, psi_best: score per point as the trajectory has it and with the offset corrected.
        observed: whether the two stretches hold every direction.
        unrivalled: whether they do, lie on each other well enough, and fit nowhere else as well.
        doubt_m: how far the two may be off each other, since poses are interpolated [m].
        rivals: (R, 3) other offsets at which they fit about as well; none where these were not asked for.
        repeats: (L, 3) the offset as other scans show it, of which `offset` is the median; none where it was measured once.
    """

    earlier: int
    later: int
    between: se2.Array
    path_m: float
    offset: se2.Array
    covariance: NDArray[np.float64]
    centre: NDArray[np.float64]
    spread_m: float
    matched: float
    psi: float
    psi_best: float
    observed: bool
    unrivalled: bool
    doubt_m: float = 0.0
    rivals: se2.Array = field(default_factory=lambda: np.empty((0, 3)))
    repeats: se2.Array = field(default_factory=lambda: np.empty((0, 3)))

    @property
    def size_m(self) -> float:
        """Root mean square of how far the offset moves the points of the later stretch [m]."""
        return self.move_points(self.offset)

    def move_points(self, offset: se2.Array) -> float:
        """Returns the root mean square of how far an offset (3,) moves the points of the later stretch [m]."""
        moved = se2.transform(offset, self.centre[None])[0] - self.centre
        return float(np.hypot(np.hypot(*moved), 2.0 * np.sin(0.5 * offset[2]) * self.spread_m))


def ask_of_scans(settings: AuditConfig) -> AuditConfig:
    """Returns settings that ask of a few scans as much as they can match, which is less than maps of many scans can."""
    return settings.model_copy(update={"matched": settings.scan_matched * settings.matched})


def ask_of_single_scans(settings: AuditConfig) -> AuditConfig:
    """Returns settings that ask of a single scan as much as it can match, and fewer points than of several."""
    return ask_of_scans(settings).model_copy(update={"fewest": _SPEED_FEWEST})


def measure_span(sweeps: Sweeps, begin: int) -> float:
    """Returns the time [s] from a sweep to the next one."""
    return max(
        float(sweeps.numbers[begin + 1] - sweeps.numbers[begin]) * sweeps.revolution_s,
        float(sweeps.times[begin + 1] - sweeps.times[begin]),  # across a pause of the recording
    )


def compute_far_reach(span_s: float, settings: AuditConfig) -> tuple[float, float]:
    """Returns how far [m], [rad] a wide search goes: as far as any plausible error of the speed leads in a time [s]."""
    return min(SPEED_ERROR_MPS * span_s, settings.gate_m), settings.search_rad


def fits_far_better(registration: Registration) -> bool:
    """Returns whether two stretches fit where a wide search has laid them, and not where the trajectory has them."""
    return registration.unrivalled and registration.psi_best * RIVAL <= registration.psi


def register(
    sweeps: Sweeps,
    frames: tuple[int, int],
    stretches: tuple[Sequence[int], Sequence[int]],
    reach: tuple[float, float],
    settings: AuditConfig,
    estimator: EstimatorConfig,
    rival_sigmas: float | None = None,
) -> Registration | None:
    """Lays one stretch on another; returns None where either holds too few points.

    Args:
        sweeps: points under the trajectory to judge.
        frames: the earlier and the later sweep in whose frames the stretches are laid.
        stretches: the sweeps of the earlier stretch, and of the later one.
        reach: how far the later stretch may be off in position [m] and in yaw [rad].
        settings: of the audit.
        estimator: settings of the score.
        rival_sigmas: by how many standard deviations of chance the stretches must fit worse elsewhere; None where rivals
            need not be known.
    """
    a, b = frames
    reference, query = (sweeps.local(part, sweeps.poses[k]) for part, k in zip(stretches, frames, strict=True))
    if min(len(reference), len(query)) < settings.fewest:
        return None
    between = se2.wrapped_between(sweeps.poses[a], sweeps.poses[b])
    references = make_references(reference)
    alignment = align(references, query, between, reach, estimator, rival_sigmas)
    centre = query.points.mean(axis=0)
    return Registration(
        earlier=a,
        later=b,
        between=between,
        path_m=float(sweeps.travelled[b] - sweeps.travelled[a]),
        offset=se2.wrapped_between(between, alignment.pose),
        covariance=se2.rotate_covariance(alignment.covariance, -between[2]),
        centre=centre,
        spread_m=float(np.sqrt(np.mean(np.sum((query.points - centre) ** 2, axis=1)))),
        matched=alignment.matched,
        psi=score_at_pose(references, query, between, estimator),
        psi_best=alignment.psi,
        observed=alignment.observed,
        unrivalled=is_unrivalled(alignment, settings.matched),
        doubt_m=sweeps.doubt(stretches),
        rivals=se2.wrapped_between(between, alignment.rivals),
    )
