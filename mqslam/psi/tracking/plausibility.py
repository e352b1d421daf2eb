"""Whether a scan can be matched, and whether the place where it was found in a map can be believed."""

from __future__ import annotations

import numpy as np

from mqslam.config import TrackerConfig
from mqslam.core.scans import Scan
from mqslam.psi.minimiser import Minimum


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
