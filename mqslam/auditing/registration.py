"""Registers one stretch of a map (some of its sweeps) on another by psi, and compares the result with the trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.sweeps import Sweeps
from mqslam.backend.loops.registration import RIVAL, align, is_unrivalled, score_at_pose
from mqslam.config import AuditConfig, EstimatorConfig
from mqslam.core import se2
from mqslam.psi.score import make_references

Shared: TypeAlias = tuple[Sweeps, AuditConfig, EstimatorConfig]
"""Points under the trajectory to judge, settings of the audit and settings of the score."""

# Largest error of a trajectory's speed [m/s] that is searched for between two successive scans. Vehicles drive more slowly,
# so the search also finds a trajectory that wrongly stands still.
SPEED_ERROR_MPS = 50.0
# The speed is not checked between two successive scans if either of them has fewer points than this.
_SPEED_FEWEST = 40
# Distance between the points that fill surfaces, divided by the kernel's width. With less than half of it, ratios of psi
# change by 4 % at most.
_FILLED = 0.125
# Largest distance between points amid a surface, divided by the largest distance between points of one surface.
_AMID = 0.5


@dataclass(frozen=True, slots=True)
class Registration:
    """The registration of a later stretch of sweeps on an earlier stretch.

    Args:
        earlier, later: numbers of two sweeps, one in each stretch. Each stretch is given in the frame of the sensor at the
            start of its sweep.
        between: (3,) pose of the later sweep in the frame of the earlier sweep by the trajectory [m, m, rad].
        path_m: length of the path between the two sweeps [m].
        offset: (3,) correction of the later stretch: its best pose by psi relative to its pose by the trajectory, in the
            frame of the later sweep [m, m, rad].
        covariance: (3, 3) covariance of `offset` from the curvature of psi.
        centre: (2,) mean of the points of the later stretch, in the frame of the later sweep [m].
        spread_m: root mean square distance of these points from `centre` [m].
        matched: share of the points of the later stretch that lie on the earlier stretch once the offset is corrected.
        psi, psi_best: score per point without and with the offset corrected.
        observed: whether the two stretches constrain the offset in every direction.
        unrivalled: whether `observed` holds, the two stretches match well enough, and they fit nowhere else as well.
        doubt_m: largest error of the offset that interpolation between given poses can cause [m].
        rivals: (R, 3) other offsets [m, m, rad] at which the stretches fit about as well; empty if not asked for.
        repeats: (L, 3) measurements of the offset [m, m, rad], the first with these stretches and the others with sweeps
            next to them; `offset` is their median. Empty if measurements are not repeated.
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
        """Root mean square distance by which the offset moves the points of the later stretch [m]."""
        return self.move_points(self.offset)

    def move_points(self, offset: se2.Array) -> float:
        """Returns the root mean square distance [m] by which an offset (3,) moves the points of the later stretch."""
        moved = se2.transform(offset, self.centre[None])[0] - self.centre
        return float(np.hypot(np.hypot(*moved), 2.0 * np.sin(0.5 * offset[2]) * self.spread_m))


def ask_of_scans(settings: AuditConfig) -> AuditConfig:
    """Returns settings that require a smaller share of matched points: a few scans match less than maps of many scans."""
    return settings.model_copy(update={"matched": settings.scan_matched * settings.matched})


def ask_of_single_scans(settings: AuditConfig) -> AuditConfig:
    """Returns settings that require a smaller share of matched points and fewer points, for single scans."""
    return ask_of_scans(settings).model_copy(update={"fewest": _SPEED_FEWEST})


def measure_span(sweeps: Sweeps, begin: int) -> float:
    """Returns the time [s] from the sweep `begin` to the next sweep.

    It is the difference of the times of the sweeps or, if longer, the difference of their numbers in revolutions.
    """
    return max(
        float(sweeps.numbers[begin + 1] - sweeps.numbers[begin]) * sweeps.revolution_s,
        float(sweeps.times[begin + 1] - sweeps.times[begin]),  # larger across a pause of the recording
    )


def compute_far_reach(span_s: float, settings: AuditConfig) -> tuple[float, float]:
    """Returns how far to search for errors of speed over `span_s` [s]: in position (at most `gate_m`) [m] and yaw [rad]."""
    return min(SPEED_ERROR_MPS * span_s, settings.gate_m), settings.search_rad


def fits_far_better(registration: Registration) -> bool:
    """Returns whether two stretches fit clearly better with the offset corrected than by the trajectory or anywhere else."""
    return registration.unrivalled and registration.psi_best * RIVAL <= registration.psi


def is_of_beams(
    registration: Registration, stretches: tuple[Sequence[int], Sequence[int]], sweeps: Sweeps, estimator: EstimatorConfig
) -> bool:
    """Returns whether a better fit with the offset corrected may come from the pattern of a lidar's beams alone.

    The beams of a lidar hit a bare wall at the same places of a scan wherever the lidar stands along the wall. Two scans of
    the wall therefore fit best as if the lidar had not moved. This pattern vanishes if points are added along the surfaces
    of the earlier stretch, and if of the later stretch only points amid a surface are kept. If the later stretch then fits
    not clearly better with the correction, the pattern alone explains the better fit. The result is False for a radar.

    Args:
        registration: registration of the later stretch on the earlier stretch.
        stretches: numbers of the sweeps of the earlier stretch, and of the later stretch.
        sweeps: points under the trajectory to judge.
        estimator: settings of the score.
    """
    if not sweeps.is_of_lidar:
        return False
    earlier, later = stretches
    apart_m, every_m = estimator.s_start, _FILLED * estimator.s
    references = make_references(sweeps.local_surfaces(earlier, sweeps.poses[registration.earlier], apart_m, every_m))
    query = sweeps.local_amid(later, sweeps.poses[registration.later], _AMID * apart_m)
    if not len(query):
        return True
    moved = se2.compose(registration.between, registration.offset)
    kept_psi, moved_psi = (score_at_pose(references, query, pose, estimator) for pose in (registration.between, moved))
    return moved_psi * RIVAL > kept_psi


def register(
    sweeps: Sweeps,
    frames: tuple[int, int],
    stretches: tuple[Sequence[int], Sequence[int]],
    reach: tuple[float, float],
    settings: AuditConfig,
    estimator: EstimatorConfig,
    rival_sigmas: float | None = None,
) -> Registration | None:
    """Registers a later stretch of sweeps on an earlier stretch by psi; returns None if either holds too few points.

    Args:
        sweeps: points under the trajectory to judge.
        frames: numbers of the earlier and the later sweep in whose frames the two stretches are given.
        stretches: numbers of the sweeps of the earlier stretch, and of the later stretch.
        reach: how far the later stretch may be off in position [m] and in yaw [rad].
        settings: settings of the audit.
        estimator: settings of the score.
        rival_sigmas: another offset is a rival unless its score is worse than the best score by this many standard
            deviations of the difference; None if rivals need not be known.
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
