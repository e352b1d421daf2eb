"""Whether a scan can be matched, and whether the place where it was found in a map can be believed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mqslam.config import TrackerConfig
from mqslam.core.scans import Scan
from mqslam.psi.minimiser import Minimum


@dataclass(frozen=True, slots=True)
class Usual:
    """How well scans usually match: a mean that forgets slowly.

    Args:
        share: matched share.
        psi: psi per return; infinite before the first match.
    """

    share: float = 0.0
    psi: float = float("inf")

    def after(self, minimum: Minimum, settings: TrackerConfig) -> Usual:
        """Returns what is usual after one more match."""
        share, psi = measure_overlap(minimum), _measure_psi(minimum)
        if not np.isfinite(self.psi):
            return Usual(share, psi)
        kept = settings.usual_memory
        return Usual(kept * self.share + (1.0 - kept) * share, kept * self.psi + (1.0 - kept) * psi)

    def is_poor(self, share: float, settings: TrackerConfig) -> bool:
        """Returns whether a matched share is much poorer than the usual one."""
        return share < settings.lost_share * self.share

    def is_doubtful(self, minimum: Minimum, settings: TrackerConfig) -> bool:
        """Returns whether psi of a match is so much larger than usual that there may be a better one beside it."""
        return _measure_psi(minimum) > settings.doubtful_psi * self.psi


def is_usable(scan: Scan, settings: TrackerConfig) -> bool:
    """Returns whether a scan holds enough returns, in more than one direction, to be matched."""
    if len(scan.returns) < settings.fewest_returns:
        return False
    x, y = np.cos(scan.returns.azimuths), np.sin(scan.returns.azimuths)
    around = np.arctan2(y * x.mean() - x * y.mean(), x * x.mean() + y * y.mean())  # about their mean direction
    return bool(np.ptp(around) > settings.least_sector)


def overlaps(minimum: Minimum, settings: TrackerConfig) -> bool:
    """Returns whether a scan lies on the map at all."""
    matched = int(np.count_nonzero(minimum.evaluation.matched))
    return matched >= settings.least_matched and measure_overlap(minimum) >= settings.least_share


def measure_overlap(minimum: Minimum) -> float:
    """Returns the share of a scan's returns that found a neighbour in the map."""
    matched = minimum.evaluation.matched
    return float(matched.mean()) if len(matched) else 0.0


def _measure_psi(minimum: Minimum) -> float:
    """Returns psi per return of a scan."""
    return minimum.evaluation.psi / max(len(minimum.evaluation.matched), 1)
