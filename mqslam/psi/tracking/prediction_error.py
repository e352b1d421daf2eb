"""How well predictions foresee where the next scan lies: the match of a scan begins only as wide as they err.

Among vehicles that keep pace with the sensor, a second motion explains many returns. A search that begins wide may end
there, one that begins at a good prediction does not.
"""

from __future__ import annotations

import numpy as np

from mqslam.config import EstimatorConfig
from mqslam.psi.minimiser import annealed_scale, final_scale
from mqslam.psi.place import PointSet
from mqslam.psi.tracking.setup import Tuning

# Number of scans of a new track that are measured again together, once they make a map.
YOUNG_SCANS = 16
# Number of past scans that show how well predictions foresee where returns lie.
_PREDICTION_SCANS = 40

# Share of those scans whose predictions erred by less than what is expected of the next.
_PREDICTION_SHARE = 0.9


class PredictionErrors:
    """Errors of the predictions of the last scans.

    Args:
        tuning: how much wider than the errors of predictions a match begins.
        matching: settings of the score where a scan is matched to the running map.
    """

    def __init__(self, tuning: Tuning, matching: EstimatorConfig) -> None:
        self._tuning = tuning
        self._matching = matching
        self._errors: list[float] = []

    def add(self, predicted: PointSet, matched: PointSet) -> None:
        """Takes the returns of a scan where its prediction put them, and where its match did."""
        moved = matched.points - predicted.points
        error = float(np.sqrt(np.mean(np.sum(moved**2, axis=1))))
        self._errors = [*self._errors, error][-_PREDICTION_SCANS:]

    @property
    def is_young(self) -> bool:
        """Whether the track has only begun, or gone on after a loss, so that too few predictions are known."""
        return len(self._errors) < min(YOUNG_SCANS, _PREDICTION_SCANS)

    def forget(self) -> None:
        """Forgets all errors, where a track begins or goes on after a loss."""
        self._errors = []

    def choose_step(self) -> int:
        """Returns the step of the annealing at which the match of the next scan begins."""
        tuning, matching = self._tuning, self._matching
        step = tuning.first_step
        if self.is_young:
            return step
        least = tuning.prediction_margin * float(np.quantile(self._errors, _PREDICTION_SHARE))
        while annealed_scale(matching, step) != final_scale(matching) and annealed_scale(matching, step + 1).beta_s >= least:
            step += 1
        return step
