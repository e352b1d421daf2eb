"""Sizes that all parts of an audit share: scans per window and per step, and the inflation that chance hardly exceeds."""

from __future__ import annotations

from typing import Final

from scipy.stats import chi2

# Number of scans in a window.
WINDOW = 6
# Number of scans on either side of a step, and around either end of a span, that are registered on each other.
STEP_SCANS: Final = 3
# The usual offset of a step without a jump is estimated only from at least this many steps.
STEP_FEWEST = 20
# Probability of the chi-square quantile above which the inflation of a window or a revisit shows that it is torn.
PROBABILITY: Final = 0.999
# A window or a revisit with a larger inflation than this is off by more than chance. The inflation has three degrees of
# freedom.
TORN_INFLATION: Final = float(chi2.ppf(PROBABILITY, 3))
