"""A scan matched to a map by psi: with a prediction, or by a search around one that may be far off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core.scans import Scan
from mqslam.psi.correlate import compute_same_m, find_correlation_peaks
from mqslam.psi.covariance import sum_by_object
from mqslam.psi.minimiser import Minimum, Prior, Search, annealed_scale, final_scale, minimise
from mqslam.psi.observability import find_weak_directions
from mqslam.psi.place import PointSet, place
from mqslam.psi.scoring.estimator import PsiEvaluation, Scale
from mqslam.psi.scoring.references import evaluate_against
from mqslam.psi.tracking.local_map import LocalMap
from mqslam.psi.tracking.setup import Setup
from mqslam.psi.tracking.state import MODEL, POSE, TOLERANCES, Belief, State
from mqslam.psi.window import RIVAL

# Largest number of Newton steps when a scan is matched; with a good prediction a few are enough.
_MATCHING_STEPS = 24
# The search ends with a step shorter than this many standard deviations, which psi's curvature states.
_SETTLED = 0.05
# A direction that seems not observed counts as observed if every shift of the scan along it raises psi by more than this
# many standard deviations of the rise. Along a bare corridor there is always a shift that raises it by less than 1.5, in
# streets full of traffic there is none below 2.2.
_DISTINCT_SIGMAS = 2.0

# Largest angle by which a scan is turned to find a better match beside a doubtful one [rad]. A vehicle that begins to turn
# at 0.5 rad/s turns by about so much more within a scan than it did in the one before.
_BESIDE_TURN = 0.08
# Number of angles that are tried to either side of a doubtful match.
_BESIDE_TURNS = 4
# Half width of the search for a scan around its prediction, in the prediction's standard deviations.
_SEARCH_SIGMAS = 2.0
# Least half width of the search for a scan [m], however sure the prediction claims to be.
_SEARCH_LEAST_M = 3.0
# Least half width of the search for a scan in yaw [rad], however sure the prediction claims to be.
_SEARCH_LEAST_RAD = 0.05
# Largest half width of the search for a scan [m].
_SEARCH_MOST_M = 30.0
# Largest half width of the search for a scan in yaw [rad].
_SEARCH_MOST_RAD = 0.8


@dataclass(frozen=True, slots=True)
class Match:
    """Where a search found a scan.

    Args:
        minimum: the best match.
        rivalled: whether another place in the map fits about as well.
    """

    minimum: Minimum
    rivalled: bool


@dataclass(frozen=True, slots=True)
class Matcher:
    """Matches scans to a map.

    Args:
        setup: settings and sensor.
    """

    setup: Setup

    def place(self, scan: Scan, state: State) -> PointSet:
        """Renders a scan under a state."""
        return place(scan.returns, scan.t0, state.pose, state.motion, MODEL, self.setup.beam)

    def evaluate(self, scan: Scan, state: State, into: LocalMap) -> PsiEvaluation:
        """Scores a scan under a state against a map, at the widths that the minimiser ends with."""
        return self._score(self.place(scan, state), final_scale(self.setup.matching), into)

    def find_weak_directions(self, scan: Scan, state: State, into: LocalMap) -> NDArray[np.float64]:
        """Returns the directions (K, 3) of the start pose that a map does not show around a match.

        In dense traffic, clutter hides at the widest scale what the scan shows at the final one. A direction that seems
        weak is therefore looked along: where the match stands out from all shifts of the scan, it is no chance.

        All views count the same here. Where neighbours that were seen from the same direction counted more, even a bare
        wall would seem to hold the scan: at the place that the map was seen from.
        """
        config = self.setup.matching
        wide = self._score(self._place_blindly(scan, state), annealed_scale(config, 0), into)
        weak = find_weak_directions(wide, 3)
        return weak[[not self._stands_out(scan, state, direction, into) for direction in weak]]

    def minimise(self, scan: Scan, start: State, prior: Prior, into: LocalMap, first_step: int = 0) -> Minimum:
        """Finds the state near a start that minimises psi plus the prior; see `mqslam.psi.minimiser.minimise`."""
        setup = self.setup
        search = Search(_MATCHING_STEPS, first_step, _SETTLED, foresees=True, correlation=setup.tuning.correlation)
        return minimise(
            start.vector,
            lambda vector: self.place(scan, State(vector)),
            into.references,
            prior,
            setup.matching,
            setup.kernel,
            TOLERANCES,
            search,
        )

    def search(self, scan: Scan, predicted: Belief, into: LocalMap, known: Sequence[Minimum]) -> Match:
        """Finds the best match in the whole region that a prediction allows.

        Args:
            scan: the scan.
            predicted: its state as predicted, with the uncertainty that bounds the search.
            into: the map.
            known: at least one match that was there before; it takes part.
        """
        minima = [*known, *self._refine_peaks(scan, predicted, into)]
        minima.sort(key=lambda minimum: minimum.evaluation.psi)
        best = minima[0]
        config = self.setup.matching
        elsewhere = [m for m in minima[1:] if np.hypot(*(m.state - best.state)[:2]) > compute_same_m(config)]
        rivalled = any(m.evaluation.psi < RIVAL * best.evaluation.psi for m in elsewhere)
        return Match(best, rivalled)

    def look_beside(self, scan: Scan, minimum: Minimum, information: NDArray[np.float64], into: LocalMap) -> Minimum | None:
        """Finds a better match beside one, or returns None where there is none: ahead, behind, or turned to either side.

        Vehicles that keep pace with the sensor have a minimum of their own. Where all set off together, a match that begins
        at the prediction may stay with them, although psi is much lower a few decimetres ahead. Where the sensor turns more
        suddenly than predicted, returns far away match others than their own.

        Args:
            scan: the scan.
            minimum: a match of it.
            information: (8, 8) of the prediction.
            into: the map.
        """
        config, scale = self.setup.matching, final_scale(self.setup.matching)
        here = State(minimum.state)
        turn_s = self.setup.revolution_s
        ahead = np.arange(config.beta_s, config.beta_s_start, config.beta_s)
        turns = _BESIDE_TURN / _BESIDE_TURNS * np.arange(1, _BESIDE_TURNS + 1)
        beside = [here.moved_ahead(distance, turn_s) for distance in (*-ahead, *ahead)]
        # how far a scan's own start has turned depends on when the turn began: before the scan or within it
        beside += [here.turned(share * angle, angle / turn_s) for angle in (*-turns, *turns) for share in (0.5, 1.0)]
        best = min(beside, key=lambda state: self._score(self.place(scan, state), scale, into).psi)
        other = self.minimise(scan, best, Prior(best.vector, information), into, _MATCHING_STEPS)
        rise = minimum.evaluation.shares - other.evaluation.shares
        return other if self._is_distinct(rise, self.place(scan, State(other.state))) else None

    def _is_distinct(self, rise: NDArray[np.float64], placed: PointSet) -> bool:
        """Returns whether psi rises by more than chance explains: by some standard deviations of its sums over objects.

        Args:
            rise: (N,) by how much each point's share of psi rises.
            placed: the points before that.
        """
        config = self.setup.matching
        by_object = sum_by_object(rise[:, None], placed.points, config.cluster_m)
        return bool(by_object.sum() > _DISTINCT_SIGMAS * np.sqrt(np.sum(by_object**2)))

    def _stands_out(self, scan: Scan, state: State, direction: NDArray[np.float64], into: LocalMap) -> bool:
        """Returns whether psi is lower at a match than at any shift of the scan along a direction (3,) of the start pose.

        The shifts reach as far as the widest scale. Each difference of psi is compared with its own spread over objects.
        """
        config = self.setup.matching
        points = self._place_blindly(scan, state)
        moved = np.sqrt(np.mean(np.sum((points.jacobians[:, :, POSE] @ direction) ** 2, axis=1)))
        scale = final_scale(config)
        here = self._score(points, scale, into)
        for distance in np.arange(config.s, config.s_start + config.beta_s, config.beta_s):
            for sign in (-1.0, 1.0):
                shifted = state.vector.copy()
                shifted[POSE] += sign * distance / moved * direction
                rise = self._score(self._place_blindly(scan, State(shifted)), scale, into).shares - here.shares
                if not self._is_distinct(rise, points):
                    return False
        return True

    def _place_blindly(self, scan: Scan, state: State) -> PointSet:
        """Renders a scan without the directions that it sees its points from."""
        placed = self.place(scan, state)
        return PointSet(placed.points, placed.jacobians, placed.covariances, placed.times)

    def _score(self, placed: PointSet, scale: Scale, into: LocalMap) -> PsiEvaluation:
        return evaluate_against(placed, into.references, scale, self.setup.kernel)

    def _refine_peaks(self, scan: Scan, predicted: Belief, into: LocalMap) -> list[Minimum]:
        """Returns the minima that start from the peaks of a correlation around the prediction."""
        x, y, yaw = np.sqrt(np.diag(predicted.covariance))[:3]
        reach_m = float(np.clip(_SEARCH_SIGMAS * np.hypot(x, y), _SEARCH_LEAST_M, _SEARCH_MOST_M))
        reach_rad = float(np.clip(_SEARCH_SIGMAS * yaw, _SEARCH_LEAST_RAD, _SEARCH_MOST_RAD))
        own = self.place(scan, State.of(np.zeros(3), predicted.mean.motion)).points
        information = predicted.information
        minima = []
        peaks = find_correlation_peaks(
            into.references.points.points, own, predicted.pose, reach_m, reach_rad, self.setup.matching
        )
        for pose in peaks:
            start = State.of(pose, predicted.mean.motion)
            minima.append(self.minimise(scan, start, Prior(start.vector, information), into))
        return minima
