"""Judges revisits, the places that a trajectory comes back to: psi shows how far the two passes of a place are off.

At successive revisits, the later pass is displaced from the earlier pass by about the same rigid motion. The offset of one
revisit can therefore be converted to the frame of the next revisit and compared with the offset there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from mqslam.auditing.registration import Registration, Shared, register
from mqslam.auditing.sizes import PROBABILITY, TORN_INFLATION
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.table import share_of_false_alarms
from mqslam.auditing.verdict import Share
from mqslam.backend.loops.passes import LATER_SHARE, find_passes, pick_around
from mqslam.backend.loops.rigid import LEAST_COVARIANCE
from mqslam.backend.marginals import RelativeCovariances
from mqslam.config import AuditConfig, VerdictConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.statistics import MEDIAN_EFFICIENCY, compute_p_values, correct_for_places, find_usual_scale
from mqslam.core.wording import count_of
from mqslam.execution.progress import Progress, count_items
from mqslam.psi.correlate import compute_same_m

_LEAST: Final = 3  # by definition: fewest offsets of a series, since two offsets may agree by coincidence


@dataclass(frozen=True, slots=True)
class Offsets:
    """Offsets of later passes: their best poses by psi, relative to their poses by a trajectory, in the order of time.

    Args:
        offsets: (N, 3) offsets in the frame of the later pose [m, m, rad].
        covariances: (N, 3, 3) covariances of the offsets.
        poses: (N, 3) later poses x, y [m], yaw [rad] by the trajectory, in the map's frame.
        places: (N, 2) length of the path up to the earlier pose and up to the later pose [m].
    """

    offsets: NDArray[np.float64]
    covariances: NDArray[np.float64]
    poses: se2.Array
    places: NDArray[np.float64]

    @property
    def inflations(self) -> NDArray[np.float64]:
        """The squared Mahalanobis distances (N,) of the offsets from zero under their covariances."""
        return se2.normalise(self.offsets, self.covariances)

    def take(self, chosen: NDArray[np.bool_]) -> Offsets:
        """Returns the offsets that the mask `chosen` (N,) selects."""
        return Offsets(self.offsets[chosen], self.covariances[chosen], self.poses[chosen], self.places[chosen])

    def carry(self, i: int, k: int) -> NDArray[np.float64]:
        """Returns the matrix (3, 3) that converts the i-th offset to the frame of the k-th later pose."""
        return se2.adjoint(se2.between(self.poses[k], self.poses[i]))

    def differ(self, i: int, k: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns the difference (3,) offset k minus offset i in the frame of the k-th later pose, and its covariance."""
        lever = self.carry(i, k)
        off = self.offsets[k] - lever @ self.offsets[i]
        return off, self.covariances[k] + lever @ self.covariances[i] @ lever.T

    def pair(self, least_m: float, most_m: float) -> list[tuple[int, int]]:
        """Returns the pairs (i, k), i < k, of offsets that are `least_m` to `most_m` [m] of path apart on both passes."""
        pairs = []
        for i, place in enumerate(self.places):
            apart = np.abs(self.places[i + 1 :] - place)
            beside = (apart.min(axis=1) >= least_m) & (apart.max(axis=1) <= most_m)
            pairs += [(i, i + 1 + int(k)) for k in np.flatnonzero(beside)]
        return pairs


def compare_neighbours(given: Offsets, least_m: float, most_m: float) -> NDArray[np.float64]:
    """Returns the squared differences (K, 3) of K pairs of neighbouring offsets, divided by their variances on each axis.

    A drift that two neighbours have in common cancels out.

    Args:
        given: the offsets.
        least_m: shortest path between neighbours, so that they share no scan [m].
        most_m: longest path between neighbours, so that a common drift does not change between them [m].
    """
    pairs = given.pair(least_m, most_m)
    differences = [given.differ(i, k) for i, k in pairs]
    return np.array([off**2 / np.diag(covariance) for off, covariance in differences]).reshape(-1, 3)


def find_agreeing(
    given: Offsets,
    usable: NDArray[np.bool_],
    rivals: list[NDArray[np.float64]],
    searched_m: NDArray[np.float64],
    most_m: float,
    same_m: float,
) -> NDArray[np.bool_]:
    """Finds series of successive offsets, each of which agrees with the next, that are too long to agree by chance.

    Two offsets agree if the squared Mahalanobis distance between them is at most the chi-square quantile of `PROBABILITY`. A
    series counts if the probability that all its offsets agree by chance is below 1 - `PROBABILITY`. A series ends where the
    passes could also agree on another offset, as in streets that repeat.

    Args:
        given: N offsets.
        usable: (N,) mask of the offsets that are measured in every direction; any other offset ends a series.
        rivals: for each offset, (R, 3) other offsets [m, m, rad] at which its passes fit about as well.
        searched_m: (N,) radius around the pose by the trajectory in which each offset was searched for [m].
        most_m: longest path between two successive offsets of a series [m].
        same_m: two offsets that are at most this far apart count as one [m].

    Returns:
        A mask (N,) of the offsets that belong to such a series.
    """
    found = np.zeros(len(given.offsets), dtype=np.bool_)
    begin, chance = 0, 1.0
    for k in range(1, len(given.offsets) + 1):
        here = 0.0
        if k < len(given.offsets) and usable[k - 1 : k + 1].all():
            here = _chance_of_agreement(given, k, rivals, searched_m[k], most_m, same_m)
        if here > 0.0:
            chance *= here
            continue
        if k - begin >= _LEAST and chance < 1.0 - PROBABILITY:
            found[begin:k] = True
        begin, chance = k, 1.0
    return found


def _chance_of_agreement(
    given: Offsets,
    k: int,
    rivals: list[NDArray[np.float64]],
    searched_m: float,
    most_m: float,
    same_m: float,
) -> float:
    """Returns the probability that offsets k - 1 and k agree by chance; 0 if a series ends between them.

    A series ends if the two offsets do not agree, if they are too far apart on the path, or if their passes could agree on
    another offset as well. The arguments are the same as for `find_agreeing`, with `searched_m` of offset k alone.
    """
    if np.abs(given.places[k] - given.places[k - 1]).max() > most_m:
        return 0.0
    off, covariance = given.differ(k - 1, k)
    if off @ np.linalg.solve(covariance, off) > TORN_INFLATION:
        return 0.0
    carried = rivals[k - 1] @ given.carry(k - 1, k).T
    apart = np.hypot(*np.moveaxis(carried[:, None, :2] - rivals[k][None, :, :2], -1, 0))
    if (apart <= same_m).any():
        return 0.0
    return min(TORN_INFLATION * float(np.sqrt(np.linalg.det(covariance[:2, :2]))) / searched_m**2, 1.0)


# A revisit that agrees with no series is sure only if the score of the next best pose is worse by this many standard
# deviations of the difference between the scores. Otherwise one of several places that look alike could win by chance.
_RIVAL_SIGMAS = 3.0
# Fewest pairs of neighbouring revisits from which the usual error of a revisit is estimated.
_REVISIT_FEWEST = 10


@dataclass(frozen=True, slots=True)
class RevisitAudit:
    """The judgement of one revisit: of two passes of one place, the later pass is registered on the earlier pass.

    Args:
        registration: registration of the later pass on the earlier pass.
        covariance: (3, 3) covariance of the offset by the measurement, plus `stated_covariance`.
        heading: yaw of the later sweep's pose in the map's frame [rad].
        inflation: offset^T covariance^-1 offset.
        sure: whether the two passes constrain every direction and fit nowhere else as well, or the revisit belongs to a
            series of revisits that agree (`find_agreeing`).
        torn: whether the two passes are off each other by more than the covariance explains and by more than a tolerance.
        p_value: probability that a good map has an offset this large at any revisit; NaN if the revisit is not sure, or if
            the map has too few revisits to show their usual error.
        stated_covariance: (3, 3) covariance that the trajectory itself states for the later pose relative to the earlier
            pose; None if it states none.
        excused: whether only the stated covariance keeps the passes from being torn.
        measured_inflation: like `inflation`, with the covariance by the measurement alone.
    """

    registration: Registration
    covariance: NDArray[np.float64]
    heading: float
    inflation: float
    sure: bool
    torn: bool = False
    p_value: float = np.nan
    stated_covariance: NDArray[np.float64] | None = None
    excused: bool = False
    measured_inflation: float = np.inf

    @property
    def offset(self) -> se2.Array:
        """The offset (3,) of the registration, in the frame of the later sweep [m, m, rad]."""
        return self.registration.offset

    @property
    def distance_m(self) -> float:
        """Distance in x and y by which the later pass is off the earlier pass [m]."""
        return float(np.hypot(self.offset[0], self.offset[1]))

    @property
    def moved(self) -> NDArray[np.float64]:
        """The offset (2,) [m] in the map's frame, which is the same at successive revisits if a whole pass is displaced."""
        return np.asarray(se2.transform([0.0, 0.0, self.heading], self.offset[None, :2])[0])


@dataclass(frozen=True, slots=True)
class Honesty:
    """The comparison of the covariances that a trajectory states with the offsets of its revisits.

    Args:
        revisits: number of sure revisits.
        nees: mean squared offset in units of its covariance, per degree of freedom; about 1 if the covariances are right.
        least, most: range that holds `nees` with a probability of 95 % if the covariances are right.
        statement: the result as a sentence.
    """

    revisits: int
    nees: float
    least: float
    most: float
    statement: str


def judge_honesty(revisits: Sequence[RevisitAudit]) -> Honesty | None:
    """Judges whether the covariances that a trajectory states explain the offsets of its revisits.

    A list of covariances of single poses lacks the correlations between poses, so the covariance of one pose relative to
    another comes out too large. Covariances that are too large are therefore reported, but are no fault. A trajectory that
    these very revisits have corrected is off there by no more than the measurements err: then the offsets fit any small
    covariance, and show nothing about the covariances.

    Returns:
        The result; None if the trajectory states no covariances or no revisit is sure.
    """
    sure = [(r.inflation, r.measured_inflation) for r in revisits if r.sure and r.stated_covariance is not None]
    if not sure:
        return None
    degrees = 3 * len(sure)
    nees, measured = (float(total) / degrees for total in np.sum(sure, axis=0))
    least, most = (float(bound) / degrees for bound in chi2.ppf([0.025, 0.975], degrees))
    chance = f"where right covariances would give {least:.2g} to {most:.2g}"
    by = f", judged by {count_of(len(sure), 'revisit')}: NEES/3 is {nees:.2g}, {chance}"
    if measured <= most:
        what = f"are not tested: at {count_of(len(sure), 'revisit')} it is off by no more than psi errs, as after a loop"
        by = ""
    elif nees > most:
        what = f"are too small: errors are {np.sqrt(nees):.1f} times as large as stated"
    elif nees < least:
        what = "are larger than the errors, or lack the correlations between poses"
    else:
        what = "are as large as its errors"
    return Honesty(len(sure), nees, least, most, f"the covariances of the trajectory {what}{by}")


def audit_revisits(
    shared: Shared,
    limits: VerdictConfig,
    engine: Engine,
    progress: Progress,
    stated: RelativeCovariances | None = None,
) -> list[RevisitAudit]:
    """Judges the revisits of a map, in the order of time; leaves out revisits with too few points in either pass.

    Args:
        shared: points under the trajectory to judge, settings of the audit and settings of the score.
        limits: settings of the verdict.
        engine: where the revisits are judged; the result does not depend on it.
        progress: called as revisits are done.
        stated: covariances that the trajectory itself states for one pose relative to another; None if it states none.
    """
    pairs = find_revisit_pairs(*shared[:2])
    registered = engine.map(_register_pair, shared, pairs, count_items(progress, "revisits", len(pairs)))
    return judge_registrations([one for one in registered if one is not None], shared, limits, stated)


def doubt_interpolated(revisits: Sequence[RevisitAudit], interpolated: NDArray[np.bool_]) -> list[RevisitAudit]:
    """Returns the revisits; a revisit with a pass in a gap, where poses are guesses, becomes neither sure nor torn.

    Args:
        revisits: revisits of a map.
        interpolated: (S,) mask of the sweeps that lie in a gap of the trajectory.
    """
    return [
        replace(one, sure=False, torn=False, p_value=np.nan, excused=False)
        if interpolated[[one.registration.earlier, one.registration.later]].any()
        else one
        for one in revisits
    ]


def judge_registrations(
    registrations: Sequence[Registration],
    shared: Shared,
    limits: VerdictConfig,
    stated: RelativeCovariances | None = None,
) -> list[RevisitAudit]:
    """Judges revisits whose passes are registered already; the other arguments are the same as for `audit_revisits`.

    The covariance from psi's curvature is too small by a factor that depends on the surroundings. The usual difference
    between neighbouring revisits shows this factor. A drift of the trajectory moves neighbouring revisits alike, so it does
    not change the factor. A sure revisit is torn if its inflation, and its offset in position or in yaw, are above fixed
    limits. But if the trajectory states covariances and the revisit has a p-value, the revisit is torn if it is off by more
    than chance explains and by more than `settings.jump_m`.
    """
    if not registrations:
        return []
    sweeps, settings, estimator = shared
    measured, freedom = _measure_offsets(registrations, sweeps, settings)
    sure = np.array([one.unrivalled and not len(one.rivals) for one in registrations])
    sure |= find_agreeing(
        measured,
        np.array([one.observed for one in registrations]),
        [one.rivals for one in registrations],
        np.array([compute_reach(one.path_m, settings)[0] for one in registrations]),
        settings.least_path_m,
        compute_same_m(estimator),
    )
    known = stated.relate([(one.earlier, one.later) for one in registrations]) if stated is not None else None
    total = measured if known is None else replace(measured, covariances=measured.covariances + known)
    inflations = total.inflations
    p_values = np.full(len(registrations), np.nan)
    if freedom > 0.0:
        p_values[sure] = compute_p_values(inflations[sure], freedom)
    p_values = correct_for_places(p_values)
    is_far = (np.hypot(*total.offsets[:, :2].T) > settings.torn_m) | (np.abs(total.offsets[:, 2]) > settings.torn_rad)
    torn = sure & is_far & (inflations > TORN_INFLATION)  # by fixed limits, which need no p-values
    excused = np.zeros_like(torn)
    if known is not None:
        is_large = np.array([one.size_m for one in registrations]) > settings.jump_m
        torn = np.where(np.isfinite(p_values), is_large & (p_values < share_of_false_alarms(limits)), torn)
        excused = ~torn & sure & is_far & (measured.inflations > TORN_INFLATION)
    return [
        RevisitAudit(
            registration=one,
            covariance=total.covariances[k],
            heading=float(total.poses[k, 2]),
            inflation=float(inflations[k]),
            sure=bool(sure[k]),
            torn=bool(torn[k]),
            p_value=float(p_values[k]),
            stated_covariance=None if known is None else known[k],
            excused=bool(excused[k]),
            measured_inflation=float(measured.inflations[k]),
        )
        for k, one in enumerate(registrations)
    ]


def _measure_offsets(registrations: Sequence[Registration], sweeps: Sweeps, settings: AuditConfig) -> tuple[Offsets, float]:
    """Returns the offsets of revisits, and the degrees of freedom of the factor by which their covariances were scaled.

    The factor, which is at least 1, makes the covariances explain the usual difference between neighbouring revisits. With
    too few neighbours the covariances are not scaled, and the degrees of freedom are 0.
    """
    curvature = Offsets(
        offsets=np.array([one.offset for one in registrations]),
        covariances=np.array([one.covariance for one in registrations]) + LEAST_COVARIANCE,
        poses=sweeps.poses[[one.later for one in registrations]],
        places=np.array([sweeps.travelled[[one.earlier, one.later]] for one in registrations]),
    )
    known = curvature.take(np.array([one.observed for one in registrations]))
    squares = compare_neighbours(known, 2.0 * settings.submap_m, settings.least_path_m)
    if len(squares) < _REVISIT_FEWEST:
        return curvature, 0.0
    scaled = se2.scale_covariance(curvature.covariances, find_usual_scale(squares))
    return replace(curvature, covariances=scaled), MEDIAN_EFFICIENCY * len(known.offsets)


def share_torn_revisits(revisits: Sequence[RevisitAudit]) -> Share:
    """Returns the share of torn revisits among the sure revisits."""
    sure = [revisit for revisit in revisits if revisit.sure]
    return Share(sum(revisit.torn for revisit in sure), len(sure))


def find_revisit_pairs(sweeps: Sweeps, settings: AuditConfig) -> list[tuple[int, int]]:
    """Finds pairs (earlier, later) of sweeps that may show one place; each later sweep gets the nearest earlier pass only.

    The later sweeps are about `settings.spacing_m` of path apart.
    """
    passes = find_passes(
        sweeps.travelled,
        sweeps.poses,
        settings.spacing_m,
        settings.least_path_m,
        lambda path_m: np.minimum(settings.reach_m + settings.drift * path_m, settings.gate_m),
    )
    return [nearest[0] for nearest in passes if nearest]


def compute_reach(path_m: float, settings: AuditConfig) -> tuple[float, float]:
    """Returns how far two passes with `path_m` [m] of path between them may be off in position [m] and in yaw [rad]."""
    position_m = min(settings.search_m + settings.drift * path_m, settings.gate_m)
    yaw = min(settings.search_rad + settings.drift_rad * path_m, settings.gate_rad)
    return position_m, yaw


def _register_pair(shared: Shared, pair: tuple[int, int]) -> Registration | None:
    """Registers the later pass of a pair (earlier, later) on the earlier pass; None if either pass has too few points."""
    sweeps, settings, estimator = shared
    earlier, later = pair
    reach = compute_reach(float(sweeps.travelled[later] - sweeps.travelled[earlier]), settings)
    return register(sweeps, pair, pick_passes(sweeps, earlier, later, settings), reach, settings, estimator, _RIVAL_SIGMAS)


def pick_passes(sweeps: Sweeps, earlier: int, later: int, settings: AuditConfig) -> tuple[list[int], list[int]]:
    """Returns the numbers of the sweeps of the earlier pass, and of the shorter later pass that is registered on it."""
    first, second = (
        pick_around(sweeps.travelled, k, reach_m, settings.submap_spacing_m).tolist()
        for k, reach_m in ((earlier, settings.submap_m), (later, LATER_SHARE * settings.submap_m))
    )
    return first, second
