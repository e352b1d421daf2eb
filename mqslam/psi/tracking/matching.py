"""Matches a scan to a map by psi, from a prediction or by a search around it, and finds the covariance of the match."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mqslam.config import EstimatorConfig, TrackerConfig
from mqslam.core import se2
from mqslam.core.scans import Scan
from mqslam.psi.correlate import compute_same_m, pick_apart, rank_poses
from mqslam.psi.covariance import are_worse, estimate_covariance, find_weak_directions, fuse, invert
from mqslam.psi.minimiser import STABILISER, Minimum, Prior, Search, annealed_scale, final_scale, kernel_of, minimise
from mqslam.psi.neighbours import mark_near
from mqslam.psi.place import Beam, PointSet, place
from mqslam.psi.score import Kernel, PsiEvaluation, Scale, evaluate
from mqslam.psi.tracking.local_map import USUAL, LocalMap, Tuning
from mqslam.psi.tracking.state import (
    ALPHA,
    AX,
    MODEL,
    POSE,
    SIGMA_AX,
    SIGMA_VY,
    SIZE,
    SPEED_MIN,
    START_ALPHA,
    TOLERANCES,
    VY,
    YAW,
    Belief,
    State,
    drop_directions,
)
from mqslam.psi.window import RIVAL

# For the first scans of a track, whose rotation is hardly known yet: change of yaw rate per 0.25 s [rad/s] that yaw
# acceleration does not explain.
_START_OMEGA = 0.08
# Largest number of Newton steps when a scan is matched; with a good prediction a few are enough.
_MATCHING_STEPS = 24
# A step shorter than this many standard deviations of the state ends the search (`Search.settled`).
_SETTLED = 0.05
# A direction that seems not observed counts as observed if every shift of the scan along this direction raises psi by more
# than this many standard deviations of the rise. Along a bare corridor some shift always raises psi by less than 1.5 such
# deviations; in streets full of traffic every shift raises psi by 2.2 or more.
_DISTINCT_SIGMAS = 2.0

# Largest angle by which a scan is rotated to find a better match near a doubtful match [rad]. A vehicle that begins to
# rotate at 0.5 rad/s rotates by about this much more within a scan than within the scan before.
_BESIDE_TURN = 0.08
# Number of angles that are tried to either side of a doubtful match.
_BESIDE_TURNS = 4
# Half width of the search for a scan around the predicted pose, in standard deviations of the prediction.
_SEARCH_SIGMAS = 2.0
# Least and largest half width of the search for a scan in position [m] and in yaw [rad], whatever the prediction states.
_SEARCH_M, _SEARCH_RAD = (3.0, 30.0), (0.05, 0.8)


@dataclass(frozen=True, slots=True)
class Matcher:
    """Matches the scans of a track to a map. A match is the state at a minimum of psi, as a `Minimum`.

    Args:
        settings: settings of the tracker.
        estimator: settings of the score and of its minimiser.
        beam: the sensor's errors.
        revolution_s: usual duration of a revolution of the radar [s].
        tuning: settings for matching scans to the map.
        is_reversed: whether the recording is played backward, so that speeds have the opposite sign.

    Attributes:
        matching: `estimator` with wider final widths, for matches to the running map.
        young: settings of the tracker for the first scans of a track, which allow larger changes of the yaw rate.
        kernel: parameters of the score besides its widths.
    """

    settings: TrackerConfig
    estimator: EstimatorConfig
    beam: Beam
    revolution_s: float
    tuning: Tuning = USUAL
    is_reversed: bool = False
    matching: EstimatorConfig = field(init=False)
    young: TrackerConfig = field(init=False)
    kernel: Kernel = field(init=False)

    def __post_init__(self) -> None:
        tuning = self.tuning
        wider = {name: tuning.final_width * getattr(self.estimator, name) for name in ("s", "beta_s")}
        livelier = {"sigma_omega": _START_OMEGA, "sigma_alpha": START_ALPHA}
        views = {"apart_share": tuning.apart_share, "apart_blur": tuning.apart_blur * self.estimator.blur_m}
        object.__setattr__(self, "matching", self.estimator.model_copy(update=wider))
        object.__setattr__(self, "young", self.settings.model_copy(update=livelier))
        revolution_s = self.revolution_s if tuning.fades else 0.0
        object.__setattr__(self, "kernel", kernel_of(self.estimator, revolution_s)._replace(**views))

    @property
    def speeds(self) -> tuple[float, float]:
        """Slowest and fastest forward speed [m/s] that the search for the first motion tries; negative is backwards."""
        slowest, fastest = SPEED_MIN, self.settings.speed_max
        return (-fastest, -slowest) if self.is_reversed else (slowest, fastest)

    def place(self, scan: Scan, state: State) -> PointSet:
        """Renders the returns of a scan as points under a state, in the map's frame."""
        return place(scan.returns, scan.t0, state.pose, state.motion, MODEL, self.beam)

    def evaluate(self, scan: Scan, state: State, into: LocalMap) -> PsiEvaluation:
        """Scores a scan under a state against a map, at the final widths of the minimiser."""
        return self._score(self.place(scan, state), final_scale(self.matching), into)

    def find_weak_directions(self, scan: Scan, state: State, into: LocalMap) -> NDArray[np.float64]:
        """Returns the directions (K, 3) [m, m, rad] along which psi does not observe the start pose of a scan.

        K is 0 where psi observes every direction. A direction d is no unit vector: d^T G d is 1, where G is Gauss-Newton's
        information.

        At the widest scale, dense traffic can make a direction seem unobserved, although the scan shows it at the final
        scale. Shifts of the scan along such a direction are therefore scored at the final scale. If psi is clearly lower at
        the match than at all shifts, the direction counts as observed.

        From which direction a point was seen plays no part here. Otherwise, psi would seem to observe a motion along a bare
        wall, because neighbours that were seen from the same direction count more.
        """
        wide = self._score(self._place_blindly(scan, state), annealed_scale(self.matching, 0), into)
        weak = find_weak_directions(wide, 3)
        return weak[[not self._stands_out(scan, state, direction, into) for direction in weak]]

    def minimise(self, scan: Scan, start: State, prior: Prior, into: LocalMap, first_step: int = 0) -> Minimum:
        """Minimises psi plus the prior from a start (see `mqslam.psi.minimiser`); the annealing begins at `first_step`."""
        search = Search(_MATCHING_STEPS, first_step, _SETTLED, foresees=True, correlation=self.tuning.correlation)
        return minimise(
            start.vector,
            lambda vector: self.place(scan, State(vector)),
            into.references,
            prior,
            self.matching,
            self.kernel,
            TOLERANCES,
            search,
        )

    def search(
        self,
        scan: Scan,
        predicted: Belief,
        into: LocalMap,
        known: Minimum,
        is_doubtful: Callable[[Minimum], bool] | None = None,
    ) -> tuple[Minimum, bool]:
        """Finds the best match in a region around a prediction.

        The region reaches two standard deviations of the prediction far, within the limits `_SEARCH_M` and `_SEARCH_RAD`.

        Args:
            scan: the scan.
            predicted: predicted state of the scan; its covariance bounds the search.
            into: the map.
            known: a match that was found before and competes with the new matches.
            is_doubtful: returns whether a match is doubtful. If the best match is doubtful, other yaws are tried at the same
                places. None tries only the best yaw at each place. Used only if `tuning.sees_part` is set.

        Returns:
            The best match, and whether another place in the map fits the scan about as well. If `tuning.sees_part` is set,
            matches are compared by the points that they share (`_choose_by_shared`), and the second value is always False.
        """
        ranked, size_m = self._rank_poses(scan, predicted, into)
        tried = pick_apart(ranked, self.matching)
        found = self._refine(scan, tried, predicted, into)
        if self.tuning.sees_part:
            best = self._choose_by_shared(scan, [known, *found], into)
            if is_doubtful is not None and is_doubtful(best):
                # two yaws differ if they move the returns as far apart as two places do
                turned = pick_apart(ranked, self.matching, 2.0 * compute_same_m(self.matching) / size_m)
                new = [pose for pose in turned if not any(pose is other for other in tried)]
                other = self._choose_by_shared(scan, [best, *self._refine(scan, new, predicted, into)], into)
                # a match that leaves a direction unobserved may lie anywhere along it
                if other is not best and not len(self.find_weak_directions(scan, State(other.state), into)):
                    best = other
            return best, False
        minima = sorted([known, *found], key=lambda minimum: minimum.evaluation.psi)
        best = minima[0]
        elsewhere = [m for m in minima[1:] if np.hypot(*(m.state - best.state)[:2]) > compute_same_m(self.matching)]
        return best, any(m.evaluation.psi < RIVAL * best.evaluation.psi for m in elsewhere)

    def look_beside(self, scan: Scan, minimum: Minimum, information: NDArray[np.float64], into: LocalMap) -> Minimum | None:
        """Looks for a better match of a scan ahead of a match, behind the match, and rotated to either side.

        Vehicles that keep pace with the sensor make a minimum of their own. Where all vehicles set off together, a match
        that begins at the prediction may end at this minimum, although psi is much lower a few decimetres ahead. Where the
        sensor rotates more suddenly than predicted, distant returns are matched to wrong neighbours.

        Args:
            scan: the scan.
            minimum: a match of the scan.
            information: (8, 8) inverse of the covariance of the predicted state.
            into: the map.

        Returns:
            The match that begins at the best of these places, or None if its psi is not lower by more than chance.
        """
        config, turn_s, here = self.matching, self.revolution_s, State(minimum.state)
        ahead = np.arange(config.beta_s, config.beta_s_start, config.beta_s)
        turns = _BESIDE_TURN / _BESIDE_TURNS * np.arange(1, _BESIDE_TURNS + 1)
        beside = [here.moved_ahead(distance, turn_s) for distance in (*-ahead, *ahead)]
        # how far the start pose has rotated depends on whether the rotation began before the scan or within it
        beside += [here.turned(share * angle, angle / turn_s) for angle in (*-turns, *turns) for share in (0.5, 1.0)]
        best = min(beside, key=lambda state: self.evaluate(scan, state, into).psi)
        other = self.minimise(scan, best, Prior(best.vector, information), into, _MATCHING_STEPS)
        rise = minimum.evaluation.shares - other.evaluation.shares
        return other if self._is_distinct(rise, self.place(scan, State(other.state)).points) else None

    def measure_covariance(
        self, evaluation: PsiEvaluation, placed: PointSet, predicted: Belief, into: LocalMap
    ) -> NDArray[np.float64]:
        """Returns the covariance (3, 3) of a match's pose in x, y, yaw [m, m, rad].

        The covariances of psi and of the prediction are fused. psi's is large along directions that psi does not
        observe, so that the prediction decides there.

        Args:
            evaluation: psi at the match.
            placed: the scan's points at the match.
            predicted: the prediction that the match began with.
            into: the map.
        """
        correlation = self.tuning.correlation
        known = np.zeros((SIZE, SIZE))  # a vehicle hardly slides: without this, vy would seem as free as vx
        known[VY, VY] = correlation / SIGMA_VY**2
        known[AX, AX] = correlation / SIGMA_AX**2
        known[ALPHA, ALPHA] = correlation / self.settings.sigma_alpha**2
        thin = 1.0 + 1.0 / max(len(into), 1)  # the map's points err, too, but keyframes average their errors
        measured = estimate_covariance(evaluation, placed.points, self.estimator.cluster_m, known)
        return fuse(thin * measured, predicted.covariance, TOLERANCES)[POSE, POSE]

    def update_belief(
        self, minimum: Minimum, prior_information: NDArray[np.float64], weak: NDArray[np.float64] | None = None
    ) -> Belief:
        """Returns the belief about a state after a match, from which the next prediction starts.

        Args:
            minimum: the match.
            prior_information: (8, 8) inverse of the covariance of the predicted state.
            weak: (K, 3) directions of the start pose (x, y [m], yaw [rad]) that psi does not observe, along which only the
                prediction counts; None if psi observes all directions.
        """
        evaluation = minimum.evaluation
        information = (evaluation.curvature + STABILISER * evaluation.information) / self.tuning.correlation
        if weak is not None:
            information = drop_directions(information, weak, float(minimum.state[YAW]))
        units = np.outer(TOLERANCES, TOLERANCES)
        values, vectors = np.linalg.eigh(information * units)
        safe = (vectors * np.maximum(values, 0.0)) @ vectors.T / units
        return Belief(State(minimum.state), invert(safe + prior_information, 1.0 / TOLERANCES))

    def _is_distinct(self, rise: NDArray[np.float64], points: NDArray[np.float64]) -> bool:
        """Returns whether psi rises by more than chance, given the rise (N,) of the share of each point (N, 2) [m]."""
        return bool(are_worse(rise[None], points, self.matching.cluster_m, _DISTINCT_SIGMAS)[0])

    def _choose_by_shared(self, scan: Scan, minima: Sequence[Minimum], into: LocalMap) -> Minimum:
        """Returns the first of several matches, or a later one whose psi is lower by more than chance.

        Two matches are compared by the points that have references in reach at both matches. A sensor that rotates sees new
        objects. The map does not hold these objects, so their points are no evidence against a match.
        """
        best = minima[0]
        near = self._mark_near(scan, best, into)
        for other in minima[1:]:
            near_other = self._mark_near(scan, other, into)
            shown = near & near_other
            rise = best.evaluation.shares[shown] - other.evaluation.shares[shown]
            if self._is_distinct(rise, self.place(scan, State(other.state)).points[shown]):
                best, near = other, near_other
        return best

    def _mark_near(self, scan: Scan, minimum: Minimum, into: LocalMap) -> NDArray[np.bool_]:
        """Returns a mask (N,) of a scan's points that have, at a match, a reference within reach of the widest scale."""
        points = self.place(scan, State(minimum.state)).points
        return mark_near(into.references.grid, points, self.matching.s_start)

    def _stands_out(self, scan: Scan, state: State, direction: NDArray[np.float64], into: LocalMap) -> bool:
        """Returns whether psi is lower, by more than chance, at a match than at every shift of the scan along a direction.

        The direction (3,) is one of the start pose (x, y [m], yaw [rad]). Shifts reach as far as the widest scale.
        """
        config = self.matching
        points = self._place_blindly(scan, state)
        moved = np.sqrt(np.mean(np.sum((points.jacobians[:, :, POSE] @ direction) ** 2, axis=1)))
        scale = final_scale(config)
        here = self._score(points, scale, into)
        for distance in np.arange(config.s, config.s_start + config.beta_s, config.beta_s):
            for sign in (-1.0, 1.0):
                shifted = state.vector.copy()
                shifted[POSE] += sign * distance / moved * direction
                rise = self._score(self._place_blindly(scan, State(shifted)), scale, into).shares - here.shares
                if not self._is_distinct(rise, points.points):
                    return False
        return True

    def _place_blindly(self, scan: Scan, state: State) -> PointSet:
        """Renders a scan like `place`, but without viewing directions, which then play no part in the score."""
        placed = self.place(scan, state)
        return PointSet(placed.points, placed.jacobians, placed.covariances, placed.times)

    def _score(self, placed: PointSet, scale: Scale, into: LocalMap) -> PsiEvaluation:
        return evaluate(placed, into.references, scale, self.kernel)

    def _rank_poses(self, scan: Scan, predicted: Belief, into: LocalMap) -> tuple[list[se2.Array], float]:
        """Returns poses (3,) [m, m, rad] at which scan and map correlate, the best first, and the RMS range [m] of the scan.

        The poses lie around the predicted pose, in the region of `search`.
        """
        x, y, yaw = np.sqrt(np.diag(predicted.covariance))[:3]
        reach_m = float(np.clip(_SEARCH_SIGMAS * np.hypot(x, y), *_SEARCH_M))
        reach_rad = float(np.clip(_SEARCH_SIGMAS * yaw, max(self.tuning.search_rad, _SEARCH_RAD[0]), _SEARCH_RAD[1]))
        own = self.place(scan, State.of(np.zeros(3), predicted.mean.motion)).points
        ranked = rank_poses(into.references.points, own, predicted.pose, reach_m, reach_rad, self.matching)
        return ranked, float(np.sqrt(np.mean(np.sum(own**2, axis=1))))

    def _refine(self, scan: Scan, poses: Sequence[se2.Array], predicted: Belief, into: LocalMap) -> list[Minimum]:
        """Returns one match per pose (3,) [m, m, rad], at which the search begins with the predicted motion.

        The prior around each start has the prediction's covariance.
        """
        information = predicted.information
        starts = [State.of(pose, predicted.mean.motion) for pose in poses]
        return [self.minimise(scan, start, Prior(start.vector, information), into) for start in starts]
