"""Which axis of a gyroscope is the radar's vertical, and about how late its clock is: what correlates best with psi."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mqslam.core.sensors import Gyroscope, Turning

# A gyroscope whose turns correlate less with those of psi is not used. On a straight drive noise correlates with some axis
# at some delay, by far less than that.
_LEAST_CORRELATION = 0.5
# Error of the gyroscope's clock that needs no further evidence [s].
_USUAL_DELAY_S = 0.3
# A gyroscope whose clock is farther off is not used unless its turns correlate this well with those of psi. Among many
# delays some fit by chance.
_FAR_CORRELATION = 0.8

_AXES: Final = "xyz"
_STEP_S: Final = 0.05  # between the delays that are tried [s]; the calibration refines the best one


class Turns(NamedTuple):
    """The turns of successive motions as psi measured them.

    Args:
        begins, ends: (N,) of the motions [s] since the recording's start.
        yaws: (N,) [rad].
        variances: (N,) of them [rad^2].
        known: (N,) whether psi found them itself.
        drift: by how much psi's own map turns away in the root of a second, as the graph states it [rad].
    """

    begins: NDArray[np.float64]
    ends: NDArray[np.float64]
    yaws: NDArray[np.float64]
    variances: NDArray[np.float64]
    known: NDArray[np.bool_]
    drift: float

    def take(self, some: slice) -> Turns:
        """Returns a part of the turns."""
        begins, ends, yaws = self.begins[some], self.ends[some], self.yaws[some]
        return Turns(begins, ends, yaws, self.variances[some], self.known[some], self.drift)


class Start(NamedTuple):
    """Where the calibration of a gyroscope begins.

    Args:
        turning: about the axis that is the radar's vertical.
        axis: its name.
        delay_s: how late the gyroscope's clock is [s].
        correlation: of the turns that the gyroscope and psi measured, positive where both turn the same way.
    """

    turning: Turning
    axis: str
    delay_s: float
    correlation: float

    def is_convincing(self) -> bool:
        """Returns whether the correlation is more than chance gives; a clock that is far off needs more of it."""
        is_far = abs(self.delay_s) > _USUAL_DELAY_S
        return abs(self.correlation) >= (_FAR_CORRELATION if is_far else _LEAST_CORRELATION)


def find_start(gyroscope: Gyroscope, start_us: int, turns: Turns, longest_s: float) -> Start | None:
    """Finds the axis and the delay at which a gyroscope's turns correlate best with psi's; None where it covers no motion.

    Args:
        gyroscope: its readings.
        start_us: stamp [us] of the recording's time zero.
        turns: as psi measured them.
        longest_s: longest delay that is looked for, either way [s].
    """
    if len(gyroscope) < 2:
        return None
    steps = int(np.ceil(longest_s / _STEP_S))
    best: Start | None = None
    for axis, name in enumerate(_AXES):
        turning = Turning.integrate(gyroscope, start_us, axis)
        for delay_s in _STEP_S * np.arange(-steps, steps + 1):
            found = _correlate(turning.between(turns.begins + delay_s, turns.ends + delay_s), turns)
            if found is not None and (best is None or abs(found) > abs(best.correlation)):
                best = Start(turning, name, float(delay_s), found)
    return best


def _correlate(angles: NDArray[np.float64], turns: Turns) -> float | None:
    """Returns the correlation of angles (N,) with psi's turns over the motions of which both are known."""
    both = turns.known & np.isfinite(angles)
    if both.sum() < 3:
        return None
    weights = 1.0 / turns.variances[both]
    a, b = (values[both] - np.average(values[both], weights=weights) for values in (angles, turns.yaws))
    size = np.sqrt(np.sum(weights * a**2) * np.sum(weights * b**2))
    return float(np.sum(weights * a * b) / size) if size > 0.0 else None
