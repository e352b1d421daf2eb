"""How many scans an audit lays on each other, and how far from the best map is too far by chance."""

from __future__ import annotations

from typing import Final

from scipy.stats import chi2

# Number of scans in a window.
WINDOW = 6
# Number of scans before a step or around the end of a span that as many others are laid on.
STEP_SCANS: Final = 3
# Fewest steps that show how far off a step without a jump usually is.
STEP_FEWEST = 20
# Probability of the chi-square quantile that the inflation of a torn window or revisit exceeds.
PROBABILITY: Final = 0.999
# The inflation beyond which a window or a revisit is off by more than chance: it has three degrees of freedom.
TORN_INFLATION: Final = float(chi2.ppf(PROBABILITY, 3))
