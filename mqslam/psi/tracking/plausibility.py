"""Whether a scan can be matched, and whether the place where it was found in a map can be believed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mqslam.core.scans import Scan
from mqslam.psi.minimiser import Minimum

# Fewest returns of a scan that is matched: five for each of the eight numbers of its state.
FEWEST_RETURNS = 40
# Least sector that the directions of a scan's returns span [rad]. A single direction shows one pattern of ranges and no
# motion across it.
_LEAST_SECTOR = 0.2
# The track may be lost where a scan's matched share is below this part of the usual one.
_LOST_SHARE = 0.5
# Fewest matched returns of a match. Fewer coordinates than these fit the eight numbers by chance.
_LEAST_MATCHED = 16
# Least share of matched returns of a match. Below it scan and map do not overlap.
_LEAST_SHARE = 0.15
# Share of the usual matched share and psi that is kept from scan to scan when it is updated.
_USUAL_MEMORY = 0.95


@dataclass(frozen=True, slots=True)
class Usual:
    """How well scans usually match: a mean that forgets slowly.

    Args:
        share: matched share.
        psi: psi per return; infinite before the first match.
    """

    share: float = 0.0
    psi: float = float("inf")

    def after(self, minimum: Minimum) -> Usual:
        """Returns what is usual after one more match."""
        share, psi = measure_overlap(minimum), _measure_psi(minimum)
        if not np.isfinite(self.psi):
            return Usual(share, psi)
        kept = _USUAL_MEMORY
        return Usual(kept * self.share + (1.0 - kept) * share, kept * self.psi + (1.0 - kept) * psi)

    def is_poor(self, share: float) -> bool:
        """Returns whether a matched share is much poorer than the usual one."""
        return share < _LOST_SHARE * self.share

    def is_doubtful(self, minimum: Minimum, doubtful_psi: float) -> bool:
        """Returns whether psi of a match is so many times the usual one that there may be a better one beside it."""
        return _measure_psi(minimum) > doubtful_psi * self.psi


def is_usable(scan: Scan) -> bool:
    """Returns whether a scan holds enough returns, in more than one direction, to be matched."""
    if len(scan.returns) < FEWEST_RETURNS:
        return False
    x, y = np.cos(scan.returns.azimuths), np.sin(scan.returns.azimuths)
    around = np.arctan2(y * x.mean() - x * y.mean(), x * x.mean() + y * y.mean())  # about their mean direction
    return bool(np.ptp(around) > _LEAST_SECTOR)


def overlaps(minimum: Minimum) -> bool:
    """Returns whether a scan lies on the map at all."""
    matched = int(np.count_nonzero(minimum.evaluation.matched))
    return matched >= _LEAST_MATCHED and measure_overlap(minimum) >= _LEAST_SHARE


def measure_overlap(minimum: Minimum) -> float:
    """Returns the share of a scan's returns that found a neighbour in the map."""
    matched = minimum.evaluation.matched
    return float(matched.mean()) if len(matched) else 0.0


def _measure_psi(minimum: Minimum) -> float:
    """Returns psi per return of a scan."""
    return minimum.evaluation.psi / max(len(minimum.evaluation.matched), 1)
