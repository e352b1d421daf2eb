"""What robust fits to spans share."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core.gross import SIGMAS_PER_DEVIATION

HUBER: Final = 1.345
"""By definition: standard deviations beyond which a place pulls no harder, for 95 % efficiency."""
LEAST: Final = 1e-12
"""Numerical: keeps quotients finite where all places agree to the last digit."""


def measure_spread(misses: NDArray[np.float64]) -> float:
    """Returns the standard deviation of misses about zero, by their median size."""
    return max(float(np.median(np.abs(misses))) * SIGMAS_PER_DEVIATION, LEAST)
