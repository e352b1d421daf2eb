"""A scan matched to a map by psi: with a prediction, or by a search around one that may be far off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.scans import Scan
from mqslam.psi.estimator import Evaluation, Scale
from mqslam.psi.minimiser import Minimum, Prior, minimise, score
from mqslam.psi.neighbours import find_candidates
from mqslam.psi.place import Beam, PointSet, place
from mqslam.psi.tracking.correlate import PIXEL, SAME, correlation_peaks
from mqslam.psi.tracking.dynamics import MODEL, POSE, TOLERANCES, State
from mqslam.psi.tracking.local_map import LocalMap

_SEARCH_M, _SEARCH_RAD = 30.0, 0.8  # farthest that a scan is searched around its prediction
_LEAST_M, _LEAST_RAD = 3.0, 0.05  # and nearest, however sure the prediction claims to be
_SIGMAS = 2.0  # standard deviations of the prediction that are searched


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
        estimator: settings of the score and of its minimiser.
        beam: the sensor's errors.
        revolution_s: duration of a turn [s].
    """

    estimator: EstimatorConfig
    beam: Beam
    revolution_s: float

    def place(self, scan: Scan, mean: se2.Array) -> PointSet:
        """Render a scan under a state (8,)."""
        return place(scan.returns, scan.t0, mean[POSE], mean[3:], MODEL, self.beam)

    def evaluate(self, scan: Scan, mean: se2.Array, scale: Scale, into: LocalMap) -> Evaluation:
        """Score a scan under a state (8,) against a map."""
        placed = self.place(scan, mean)
        lists = find_candidates(into.grid, placed.points, scale.s)
        return score(placed, into.points, lists, scale, self.revolution_s, self.estimator)

    def minimise(self, scan: Scan, start: se2.Array, prior: Prior, into: LocalMap) -> Minimum:
        """The state near a start (8,) that minimises psi plus the prior."""
        return minimise(
            start,
            lambda mean: self.place(scan, mean),
            into.points,
            prior,
            self.estimator,
            self.revolution_s,
            TOLERANCES,
            into.grid,
        )

    def search(self, scan: Scan, predicted: State, into: LocalMap, known: Sequence[Minimum]) -> Match:
        """The best match in the whole region that a prediction allows.

        Args:
            scan: the scan.
            predicted: its state as predicted, with the uncertainty that bounds the search.
            into: the map.
            known: at least one match found before; it takes part.
        """
        minima = [*known, *self._refine_peaks(scan, predicted, into)]
        minima.sort(key=lambda minimum: minimum.evaluation.psi)
        best = minima[0]
        elsewhere = [m for m in minima[1:] if np.hypot(*(m.state - best.state)[:2]) > self._resolution_m]
        rivalled = any(m.evaluation.psi < self.estimator.rival * best.evaluation.psi for m in elsewhere)
        return Match(best, rivalled)

    def _refine_peaks(self, scan: Scan, predicted: State, into: LocalMap) -> list[Minimum]:
        """The minima that start from the peaks of a correlation around the prediction."""
        spread = np.sqrt(np.diag(predicted.covariance))
        reach_m = float(np.clip(_SIGMAS * np.hypot(spread[0], spread[1]), _LEAST_M, _SEARCH_M))
        reach_rad = float(np.clip(_SIGMAS * spread[2], _LEAST_RAD, _SEARCH_RAD))
        own = self.place(scan, np.r_[np.zeros(3), predicted.mean[3:]]).points
        pixel_m = PIXEL * self.estimator.s_start
        information = predicted.information
        minima = []
        for pose in correlation_peaks(into.points.points, own, predicted.pose, reach_m, reach_rad, pixel_m):
            start = np.r_[pose, predicted.mean[3:]]
            minima.append(self.minimise(scan, start, Prior(start, information), into))
        return minima

    @property
    def _resolution_m(self) -> float:
        """Minima nearer than this are one place [m]."""
        return SAME * PIXEL * self.estimator.s_start
