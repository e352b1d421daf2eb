"""Defines constants of all parts of an audit: numbers of scans in windows and steps, and the largest inflation by chance.

The inflation of a window or a revisit is its squared error in units of the error's covariance.
"""

from __future__ import annotations

from typing import Final

from scipy.stats import chi2

# Number of scans in a window.
WINDOW = 6
# Number of scans on either side of a step, and around either end of a span, that are registered on each other.
STEP_SCANS: Final = 3
# Fewest steps from which the usual offset of a step without a jump is estimated.
STEP_FEWEST = 20
# Probability that the inflation of a good window or revisit is at most TORN_INFLATION.
PROBABILITY: Final = 0.999
# A window or a revisit with a larger inflation than this is off by more than chance (x, y and yaw: 3 degrees of freedom).
TORN_INFLATION: Final = float(chi2.ppf(PROBABILITY, 3))
