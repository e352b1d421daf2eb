"""When azimuths are measured, and when they say so: the rate of turning drifts, and stamps come in bursts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from worlds.hard.realism import Realism

BURST = 16
"""Azimuths that the radar hands over at once."""
_FIRST = 2  # place in its burst of the first azimuth of a recording
_STEADY = 0.92  # correlation of the durations of successive turns
_START_S = 0.02  # the first azimuth is measured so late that no stamp is before time zero [s]
_AT_ONCE_S, _QUEUED_S = 1e-5, (1e-4, 2.6e-4)  # between azimuths of one burst [s]
_AT_ONCE = 0.25  # share of azimuths that are stamped right after the one before them
_LAG_S = 1.5e-4  # by which a burst is late, standard deviation [s]


@dataclass(frozen=True)
class JitteringClock:
    """The times of a simulated recording.

    Args:
        borders: (N + 1,) starts of the turns, and the end of the last [s].
        azimuths: number of azimuths per turn.
        seed: of the stamps' lateness.
    """

    borders: NDArray[np.float64]
    azimuths: int
    seed: int

    def times(self, k: int) -> NDArray[np.float64]:
        """Returns when the azimuths (A,) of turn k are measured [s]."""
        start, end = self.borders[k : k + 2]
        return np.asarray(start + (end - start) * np.arange(self.azimuths) / self.azimuths)

    def stamps(self, k: int) -> NDArray[np.float64]:
        """Returns when the azimuths (A,) of turn k are said to be measured [s]: after their burst is complete.

        The mean delay is left out, since nobody could tell it from another setting of the clock.
        """
        step = (self.borders[k + 1] - self.borders[k]) / self.azimuths
        number = k * self.azimuths + np.arange(self.azimuths) + _FIRST
        bursts, place = number // BURST, number % BURST
        first = int(bursts[0])
        delays = np.stack([self._delays(burst) for burst in range(first, int(bursts[-1]) + 1)])
        waiting = (0.5 * (BURST - 1) - place) * step
        return np.asarray(self.times(k) + waiting + delays[bursts - first, place])

    def _delays(self, burst: int) -> NDArray[np.float64]:
        """Returns by how much the azimuths of a burst are stamped after one another, about their mean [s]."""
        rng = np.random.default_rng([self.seed, 14, burst])
        steps = np.where(rng.random(BURST) < _AT_ONCE, _AT_ONCE_S, rng.uniform(*_QUEUED_S, BURST))
        mean = (_AT_ONCE * _AT_ONCE_S + (1.0 - _AT_ONCE) * 0.5 * sum(_QUEUED_S)) * 0.5 * (BURST + 1)
        return np.asarray(np.cumsum(steps) - mean + _LAG_S * rng.standard_normal())


def make_clock(turns: int, turn_rate_hz: float, azimuths: int, realism: Realism, seed: int) -> JitteringClock:
    """Makes the clock of a recording of so many turns, whose mean rate is the one given."""
    rng = np.random.default_rng([seed, 15])
    drift = np.zeros(turns)
    drift[0] = rng.standard_normal()
    for k in range(1, turns):
        drift[k] = _STEADY * drift[k - 1] + np.sqrt(1.0 - _STEADY**2) * rng.standard_normal()
    durations = (1.0 + realism.spin * (drift - drift.mean())) / turn_rate_hz
    return JitteringClock(_START_S + np.concatenate([[0.0], np.cumsum(durations)]), azimuths, seed)
