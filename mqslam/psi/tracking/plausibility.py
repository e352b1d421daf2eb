"""Judges which scans can be matched, which matches are plausible, and how much predictions err.

The matched share is the part of a scan's returns that have a selected neighbour in the map. The usual value of a quantity is
a running mean over past matches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mqslam.config import EstimatorConfig
from mqslam.core.scans import Scan
from mqslam.psi.minimiser import Minimum, annealed_scale, final_scale
from mqslam.psi.place import PointSet
from mqslam.psi.tracking.local_map import Tuning

# Fewest returns of a scan that is matched, and fewest matched returns of a match: 16 returns have four coordinates for each
# of the eight numbers of the state. The state could fit fewer returns by chance.
FEWEST_RETURNS = 16
# Least sector that the directions of a scan's returns span [rad]. A single direction shows one pattern of ranges and no
# motion across that direction.
_LEAST_SECTOR = 0.2
# The track may be lost where a scan's matched share is below this part of the usual matched share.
_LOST_SHARE = 0.5
# Least matched share of a match. With a smaller share, scan and map do not overlap.
_LEAST_SHARE = 0.15
# Weight of the old value when a scan updates the usual matched share and the usual psi.
_USUAL_MEMORY = 0.95
# Number of scans of a new track that are measured a second time, as soon as there are this many.
YOUNG_SCANS = 16
# Number of past scans whose prediction errors are kept.
_PREDICTION_SCANS = 40
# The error that is expected of the next prediction is this quantile of the kept errors.
_PREDICTION_SHARE = 0.9


@dataclass(frozen=True, slots=True)
class Usual:
    """Running means over the matches so far, in which old matches count less and less.

    Args:
        share: mean matched share.
        psi: mean psi per return; infinite before the first match.
    """

    share: float = 0.0
    psi: float = float("inf")

    def after(self, minimum: Minimum) -> Usual:
        """Returns the means, updated by one more match."""
        share, psi = minimum.evaluation.overlap, _measure_psi(minimum)
        if not np.isfinite(self.psi):
            return Usual(share, psi)
        kept = _USUAL_MEMORY
        return Usual(kept * self.share + (1.0 - kept) * share, kept * self.psi + (1.0 - kept) * psi)

    def is_poor(self, share: float) -> bool:
        """Returns whether a matched share is much lower than the usual matched share."""
        return share < _LOST_SHARE * self.share

    def is_doubtful(self, minimum: Minimum, doubtful_psi: float) -> bool:
        """Returns whether psi per return of a match exceeds `doubtful_psi` times its usual value."""
        return _measure_psi(minimum) > doubtful_psi * self.psi


class PredictionErrors:
    """The errors of the last scans' predictions; these errors decide at which annealing step the next match begins.

    Among vehicles that keep pace with the sensor, the motion of these vehicles explains many returns. A search that begins
    with wide widths may end at their motion; a search with narrow widths from a good prediction does not.

    Args:
        tuning: states the widths at which a match begins, in units of the errors of predictions.
        matching: settings of the score for matches to the running map.
    """

    def __init__(self, tuning: Tuning, matching: EstimatorConfig) -> None:
        self._tuning = tuning
        self._matching = matching
        self._errors: list[float] = []

    def add(self, predicted: PointSet, matched: PointSet) -> None:
        """Adds a prediction's error: the RMS distance [m] between a scan's points as predicted and as matched."""
        moved = matched.points - predicted.points
        error = float(np.sqrt(np.mean(np.sum(moved**2, axis=1))))
        self._errors = [*self._errors, error][-_PREDICTION_SCANS:]

    @property
    def is_young(self) -> bool:
        """Whether fewer than 16 errors are known, because the track has just begun or goes on after lost scans."""
        return len(self._errors) < YOUNG_SCANS

    def forget(self) -> None:
        """Forgets all errors, because a track begins or goes on after lost scans."""
        self._errors = []

    def choose_step(self) -> int:
        """Returns the step of the annealing at which the match of the next scan begins.

        Before enough errors are known, this is `Tuning.first_step`; then it is the last step, from `first_step` on, whose
        beta_s covers the expected error.
        """
        tuning, matching = self._tuning, self._matching
        step = tuning.first_step
        if self.is_young:
            return step
        least = tuning.prediction_margin * float(np.quantile(self._errors, _PREDICTION_SHARE))
        while annealed_scale(matching, step) != final_scale(matching) and annealed_scale(matching, step + 1).beta_s >= least:
            step += 1
        return step


def is_usable(scan: Scan) -> bool:
    """Returns whether a scan holds enough returns, in more than one direction, to be matched."""
    if len(scan.returns) < FEWEST_RETURNS:
        return False
    x, y = np.cos(scan.returns.azimuths), np.sin(scan.returns.azimuths)
    around = np.arctan2(y * x.mean() - x * y.mean(), x * x.mean() + y * y.mean())  # azimuths from the mean direction
    return bool(np.ptp(around) > _LEAST_SECTOR)


def overlaps(minimum: Minimum) -> bool:
    """Returns whether enough returns of a match have a selected neighbour for scan and map to overlap at all."""
    matched = int(np.count_nonzero(minimum.evaluation.matched))
    return matched >= FEWEST_RETURNS and minimum.evaluation.overlap >= _LEAST_SHARE


def _measure_psi(minimum: Minimum) -> float:
    """Returns psi per return of the matched scan."""
    return minimum.evaluation.psi / max(len(minimum.evaluation.matched), 1)
