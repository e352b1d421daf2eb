"""How late the clock of a GNSS receiver is, which shows in how far the vehicle gets in a few seconds.

That distance, from place to place in a straight line, depends neither on how the map lies nor on how its heading drifts. It
changes as the vehicle speeds up, brakes and turns. On a drive of constant speed it shows nothing, and the clock stays as it
is.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2

_SPAN_S: Final = 4.0  # a distance lasts so long: by far longer than a step of the search, and too short for much drift
_STEP_S: Final = 0.05  # between the delays that are tried; a parabola refines the best one
_FEWEST: Final = 20  # distances that tell a delay
_BETTER: Final = 0.5  # what a delay must leave at most of the differences, as a share, to be believed


def find_fix_delay(
    times: NDArray[np.float64],
    positions: NDArray[np.float64],
    starts: NDArray[np.float64],
    chain: se2.Array,
    longest_s: float,
) -> float:
    """Finds how late the stamps of fixes are [s]; 0 where nothing shows that they are.

    Args:
        times: (F,) of the fixes [s], increasing.
        positions: (F, 2) that were fixed [m].
        starts: (N,) of the scans [s], increasing.
        chain: (N, 3) their poses.
        longest_s: longest delay that is looked for, either way [s].
    """
    ends = starts + _SPAN_S
    whole = ends <= starts[-1]
    begins, ends = starts[whole], ends[whole]
    driven = np.hypot(*(se2.interpolate(starts, chain, ends) - chain[whole])[:, :2].T)
    delays = _STEP_S * np.arange(-np.ceil(longest_s / _STEP_S), np.ceil(longest_s / _STEP_S) + 1)
    costs = np.full(len(delays), np.inf)
    for k, delay_s in enumerate(delays.tolist()):
        fixed = np.hypot(
            *(_find_places(times, positions, ends + delay_s) - _find_places(times, positions, begins + delay_s)).T
        )
        known = np.isfinite(fixed)
        if np.count_nonzero(known) >= _FEWEST:
            costs[k] = np.mean(np.abs(fixed - driven)[known])
    best = int(np.argmin(costs))
    if not costs[best] < _BETTER * costs[len(costs) // 2] or best in (0, len(costs) - 1):
        return 0.0
    before, least, after = np.square(costs[best - 1 : best + 2])
    curvature = before - 2.0 * least + after
    return float(delays[best] + (0.5 * _STEP_S * (before - after) / curvature if np.isfinite(curvature) else 0.0))


def _find_places(
    times: NDArray[np.float64], positions: NDArray[np.float64], wanted: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Finds places (M, 2) at the times wanted (M,) between fixes (F, 2); NaN where fixes around them are missing."""
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    known = (times[after] - times[after - 1] < 0.5 * _SPAN_S) & (times[0] <= wanted) & (wanted <= times[-1])
    places = np.column_stack([np.interp(wanted, times, positions[:, axis]) for axis in range(2)])
    return np.where(known[:, None], places, np.nan)
