"""Registers one submap on another by psi: searches all poses near a guess, then minimises psi and estimates the covariance.

The search correlates the submaps as images at several yaws. psi is then minimised from the guess and the best peaks of the
correlation, and the pose with the lowest psi is chosen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.loops.passes import MATCHED
from mqslam.backend.loops.rigid import ANY_TIME, minimise_rigidly, move_rigidly, place_rigidly
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.psi.correlate import compute_same_m, pick_apart, rank_poses
from mqslam.psi.covariance import are_worse, estimate_covariance, find_sigma_by_profile, find_weak_directions
from mqslam.psi.minimiser import Minimum, annealed_scale, final_scale, kernel_of
from mqslam.psi.neighbours import mark_near
from mqslam.psi.place import PointSet
from mqslam.psi.score import PsiEvaluation, References, Scale, evaluate, make_references

# The best pose has no rival if psi at the next best pose is at least this many times psi at the best pose.
RIVAL: Final = 1.1
# An alignment that ends at most this far [m] outside the searched region is still accepted.
_BEYOND_M = 1.0
# An alignment that ends at most this far in yaw [rad] outside the searched region is still accepted.
_BEYOND_RAD = 0.05
# A submap with fewer returns than this is not registered.
_FEWEST = 300
# A registration is dropped if its position has a larger standard deviation than this [m] along an axis that the passes show.
_SURE_M = 0.3
# Standard deviation of the position [m] along a direction that the passes do not show: far larger than any search.
_OPEN_M: Final = 1e3
_STEP_M: Final = 0.1  # numerical: distance [m] between the poses by which `measure_sigma_along` measures


@dataclass(frozen=True, slots=True)
class Alignment:
    """The result of the registration of one submap, the query, on another submap, the reference.

    Args:
        pose: (3,) pose of the query's frame in the reference's frame [m, m, rad].
        covariance: (3, 3) covariance of the pose, in the reference's frame [m, m, rad].
        matched: share of the query's points that have a neighbour in the reference.
        psi: psi per point of the query at the pose.
        rival: psi per point at the best other minimum in the searched region, farther away from the pose than
            `compute_same_m`; infinite if there is none.
        observed: whether the submaps determine the pose in every direction.
        rivals: (R, 3) poses of other minima that fit about as well as the best pose [m, m, rad]: their psi is less than
            RIVAL times as large, or larger only by chance. Empty if rivals were not asked for.
        along: (2,) unit vector in the reference's frame, if the submaps show the pose except for its position along this
            direction; None if they show the whole pose.
    """

    pose: se2.Array
    covariance: NDArray[np.float64]
    matched: float
    psi: float
    rival: float
    observed: bool
    rivals: se2.Array = field(default_factory=lambda: np.empty((0, 3)))
    along: NDArray[np.float64] | None = None


def align(
    references: References,
    query: PointSet,
    guess: se2.Array,
    reach: tuple[float, float],
    config: EstimatorConfig,
    rival_sigmas: float | None = None,
) -> Alignment:
    """Finds the pose of a submap, the query, in the frame of another submap, the reference.

    Args:
        references: the reference submap in its own frame.
        query: the query submap in its own frame.
        guess: (3,) pose of the query's frame in the reference's frame [m, m, rad].
        reach: how far the guess may be off in position [m] and in yaw [rad].
        config: settings of the score.
        rival_sigmas: a pose whose psi is larger by at most this many standard deviations counts as one of the `rivals`;
            None leaves `rivals` empty.

    Returns:
        The registration; if no minimum lies within the reach, it has the guess as pose, no matched points and infinite psi.
    """
    reach_m, reach_rad = reach
    minima = []
    peaks = pick_apart(rank_poses(references.points, query.points, guess, reach_m, reach_rad, config), config)
    others = [peak for peak in peaks if not np.array_equal(peak, guess)]
    for start in [guess, *others]:
        minimum = minimise_rigidly(start, query, references, config)
        off = se2.between(guess, minimum.state)
        if np.hypot(off[0], off[1]) <= reach_m + _BEYOND_M and abs(off[2]) <= reach_rad + _BEYOND_RAD:
            minima.append(minimum)
    if not minima:
        return Alignment(guess, np.eye(3), 0.0, np.inf, np.inf, observed=False)
    minima.sort(key=lambda minimum: minimum.evaluation.psi)
    best = minima[0]
    rivals = [m for m in minima[1:] if np.hypot(*(m.state - best.state)[:2]) > compute_same_m(config)]
    points = move_rigidly(query, best.state)
    picked = np.empty((0, 3))
    if rivals and rival_sigmas is not None:
        picked = _pick_rivals(best, rivals, (references, query), rival_sigmas, config)
    return Alignment(
        pose=best.state,
        covariance=estimate_covariance(best.evaluation, points.points, config.cluster_m),
        matched=float(best.evaluation.matched.mean()),
        psi=best.evaluation.psi / len(query),
        rival=rivals[0].evaluation.psi / len(query) if rivals else np.inf,
        observed=observes_all(references, points, config),
        rivals=picked,
    )


def _pick_rivals(
    best: Minimum,
    others: Sequence[Minimum],
    submaps: tuple[References, PointSet],
    sigmas: float,
    config: EstimatorConfig,
) -> se2.Array:
    """Returns the poses (R, 3) [m, m, rad] of the other minima that fit about as well as the best minimum.

    `submaps` are the reference, and the query that is registered on it. A minimum is picked if its psi over all points is
    below RIVAL times the psi of the best minimum, or if it is not significantly worse by `sigmas` standard deviations
    (`are_worse`). This test uses only points that have a reference in reach at both poses. Other points, such as points
    beyond the end of a pass, do not show which pose is right.
    """
    references, query = submaps

    def reaches(pose: se2.Array) -> NDArray[np.bool_]:
        return np.asarray(mark_near(references.grid, place_rigidly(query.points, pose), config.s_start))

    near = reaches(best.state)
    picked = []
    for other in others:
        shown = near & reaches(other.state)
        worse = (other.evaluation.shares - best.evaluation.shares)[shown]
        by_chance = not are_worse(worse[None], query.points[shown], config.cluster_m, sigmas)[0]
        if by_chance or other.evaluation.psi < RIVAL * best.evaluation.psi:
            picked.append(other.state)
    return np.array(picked).reshape(-1, 3)


def score_at_pose(references: References, query: PointSet, pose: se2.Array, config: EstimatorConfig) -> float:
    """Returns psi per point of the query among the references, with the query at a pose (3,) in their frame [m, m, rad]."""
    return score_among(references, move_rigidly(query, pose), config).psi / len(query)


def score_among(
    references: References, points: PointSet, config: EstimatorConfig, scale: Scale | None = None
) -> PsiEvaluation:
    """Returns the score of points among references, regardless of the times of the points.

    Args:
        references: fixed points.
        points: the points to score, in the references' frame.
        config: settings of the score.
        scale: widths of the score; None takes the annealing's last widths.
    """
    return evaluate(points, references, scale or final_scale(config), kernel_of(config, ANY_TIME))


def observes_all(references: References, points: PointSet, config: EstimatorConfig) -> bool:
    """Returns whether psi, at the annealing's first widths, observes every direction in which the points can move."""
    return len(find_weak_directions(score_among(references, points, config, annealed_scale(config, 0)), 3)) == 0


def does_match(alignment: Alignment, matched: float) -> bool:
    """Returns whether the registration of two passes is determined in every direction and enough of the returns match.

    Args:
        alignment: registration of the later pass on the earlier pass.
        matched: least share of the later pass's returns that must lie on returns of the earlier pass.
    """
    return alignment.observed and alignment.matched >= matched


def is_unrivalled(alignment: Alignment, matched: float) -> bool:
    """Returns whether two passes match and `rival` is at least RIVAL times psi; takes the arguments of `does_match`."""
    return does_match(alignment, matched) and alignment.psi * RIVAL <= alignment.rival


def find_least_shown(points: PointSet) -> NDArray[np.float64]:
    """Returns the direction (2,), a unit vector, along which points determine the position of their submap the least.

    The information of each point is the inverse of its covariance.
    """
    xx, xy, yy = points.covariances.T
    inverses = np.column_stack([yy, -xy, xx]) / (xx * yy - xy**2)[:, None]
    along_x, mixed, along_y = inverses.sum(axis=0)
    least: NDArray[np.float64] = np.linalg.eigh([[along_x, mixed], [mixed, along_y]])[1][:, 0]  # eigenvalues increase
    return least


def measure_matched_information(
    references: References, points: PointSet, along: NDArray[np.float64], config: EstimatorConfig
) -> float:
    """Returns the share of matched points in the information of all points about their submap's position along a direction.

    The walls of two passes of one corridor match wherever the passes lie along the corridor. Only the few points that show
    the position along the corridor tell whether it is right, and these few hardly change the share of matched points.

    Args:
        references: fixed points.
        points: the points, in the references' frame, with covariances that are wide along surfaces.
        along: (2,) the direction, a unit vector in the references' frame.
        config: settings of the score.

    Returns:
        The share, from 0 to 1. The information of a point is one over its variance along the direction.
    """
    xx, xy, yy = points.covariances.T
    x, y = along
    shown = 1.0 / (x * x * xx + 2.0 * x * y * xy + y * y * yy)
    return float(shown @ score_among(references, points, config).matched / shown.sum())


def measure_sigma_along(
    references: References, query: PointSet, pose: se2.Array, along: NDArray[np.float64], config: EstimatorConfig
) -> float:
    """Returns the standard deviation [m] of a submap's position along a direction by `find_sigma_by_profile`.

    Args:
        references: the reference submap in its own frame.
        query: the query submap in its own frame.
        pose: (3,) pose of the query's frame in the reference's frame, at a minimum of psi [m, m, rad].
        along: (2,) the direction, a unit vector in the reference's frame.
        config: settings of the score.
    """
    offsets = np.arange(0.0, config.s_start, _STEP_M)
    offsets = np.concatenate([offsets, -offsets[1:]])
    poses = pose + offsets[:, None] * np.append(along, 0.0)
    shares = [score_among(references, move_rigidly(query, moved), config).shares for moved in poses]
    return find_sigma_by_profile(offsets, np.array(shares) - shares[0], query.points, config.cluster_m)


def align_passes(
    earlier: PointSet,
    later: PointSet,
    guess: se2.Array,
    reach: tuple[float, float],
    estimator: EstimatorConfig,
    *,
    on_surfaces: bool = False,
    partly: bool = False,
) -> Alignment | None:
    """Registers the submap of a later pass on the submap of an earlier pass by psi.

    Args:
        earlier: the earlier pass's submap in its own frame.
        later: the later pass's submap in its own frame.
        guess: (3,) pose of the later submap's frame in the earlier submap's frame [m, m, rad].
        reach: how far the guess may be off in position [m] and in yaw [rad].
        estimator: settings of the score.
        on_surfaces: whether the points are widened along surfaces (`widen_along_surfaces`). The passes then match only if,
            along the direction by `find_least_shown`, `measure_matched_information` is at least MATCHED, too. The standard
            deviation along this direction is at least `measure_sigma_along`.
        partly: whether passes on surfaces are registered even if they do not show their relative position along that
            direction, which is then the registration's `along`.

    Returns:
        The registration; None if a submap has too few returns, if the two do not match, or if the pose is too uncertain.
    """
    if len(earlier) < _FEWEST or len(later) < _FEWEST:
        return None
    references = make_references(earlier)
    alignment = align(references, later, guess, reach, estimator, rival_sigmas=0.0 if partly else None)
    does_fit = does_match(alignment, MATCHED) and np.sqrt(np.diag(alignment.covariance)[:2]).max() <= _SURE_M
    if not on_surfaces:
        return alignment if does_fit else None
    points = move_rigidly(later, alignment.pose)
    along = find_least_shown(points)
    if does_fit and measure_matched_information(references, points, along, estimator) >= MATCHED:
        sigma = measure_sigma_along(references, later, alignment.pose, along, estimator)
        if sigma <= _SURE_M:
            return replace(alignment, covariance=widen_along(alignment.covariance, along, sigma))
    if not partly or np.isinf(alignment.psi):
        return None
    return _leave_open(references, later, guess, alignment, along, estimator)


def _leave_open(
    references: References,
    query: PointSet,
    guess: se2.Array,
    alignment: Alignment,
    along: NDArray[np.float64],
    config: EstimatorConfig,
) -> Alignment | None:
    """Returns a registration that says nothing about the position along a direction.

    Along the direction, the position of the best pose is a matter of chance, and may be far from the guess. The pose with
    the lowest psi near the guess is taken instead.

    Args:
        references: the reference submap in its own frame.
        query: the query submap in its own frame.
        guess: (3,) pose of the query's frame in the reference's frame [m, m, rad].
        alignment: registration of the query on the reference, with its rivals.
        along: (2,) the direction, a unit vector in the reference's frame.
        config: settings of the score.

    Returns:
        The registration; None if the two submaps do not match, if the position across the direction is too uncertain, or if
        a pose at another position across the direction fits about as well.
    """
    pose = align_near(references, query, alignment.pose, guess, along, config)
    across = np.array([-along[1], along[0]])
    elsewhere = np.abs((alignment.rivals - alignment.pose)[:, :2] @ across) > compute_same_m(config)
    if pose is None or elsewhere.any():
        return None
    points = move_rigidly(query, pose)
    evaluation = score_among(references, points, config)
    matched = float(evaluation.matched.mean())
    covariance = estimate_covariance(evaluation, points.points, config.cluster_m)
    if matched < MATCHED or across @ covariance[:2, :2] @ across > _SURE_M**2:
        return None
    covariance = set_sigma_along(covariance, along, _OPEN_M)
    return Alignment(pose, covariance, matched, evaluation.psi / len(query), np.inf, observed=True, along=along)


def widen_along(covariance: NDArray[np.float64], along: NDArray[np.float64], sigma_m: float) -> NDArray[np.float64]:
    """Returns the covariance (3, 3) of a pose, with a standard deviation of at least `sigma_m` along a direction.

    Args:
        covariance: (3, 3) covariance of the pose [m, m, rad].
        along: (2,) the direction, a unit vector in the frame of the covariance.
        sigma_m: the least standard deviation along the direction [m].
    """
    widened = covariance.copy()
    widened[:2, :2] += max(sigma_m**2 - float(along @ covariance[:2, :2] @ along), 0.0) * np.outer(along, along)
    return widened


def set_sigma_along(covariance: NDArray[np.float64], along: NDArray[np.float64], sigma_m: float) -> NDArray[np.float64]:
    """Returns the covariance (3, 3) of a pose with another standard deviation of its position along a direction.

    The position along the direction is then correlated with nothing else.

    Args:
        covariance: (3, 3) covariance of the pose [m, m, rad].
        along: (2,) the direction, a unit vector in the frame of the covariance.
        sigma_m: the standard deviation along the direction [m].
    """
    others = np.eye(3)
    others[:2, :2] -= np.outer(along, along)
    changed = others @ covariance @ others
    changed[:2, :2] += sigma_m**2 * np.outer(along, along)
    return np.asarray(changed)


def align_near(
    references: References,
    query: PointSet,
    pose: se2.Array,
    guess: se2.Array,
    along: NDArray[np.float64],
    config: EstimatorConfig,
) -> se2.Array | None:
    """Minimises psi near a guess for submaps that do not show their position along a direction.

    Args:
        references: the reference submap in its own frame.
        query: the query submap in its own frame.
        pose: (3,) pose of the query's frame in the reference's frame, right but for its position along the direction
            [m, m, rad].
        guess: (3,) the pose that gives the position along the direction [m, m, rad].
        along: (2,) the direction, a unit vector in the reference's frame.
        config: settings of the score.

    Returns:
        The pose (3,) [m, m, rad]; None if its position across the direction is not the position of `pose`.
    """
    start = pose + np.array([*((guess - pose)[:2] @ along * along), 0.0])
    near = minimise_rigidly(start, query, references, config).state
    return near if abs((near - pose)[:2] @ [-along[1], along[0]]) <= compute_same_m(config) else None
