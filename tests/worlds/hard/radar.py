"""The radar itself: when it measures azimuths and when it says so, its beam in elevation, and its receiver.

The rate of turning drifts, stamps come in bursts, and the vehicle's pitch and roll tip the beam.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, uniform_filter1d
from scipy.signal import lfilter
from worlds.hard.realism import Realism

from mqslam.simulator.beam import COUNTS_PER_DECADE
from mqslam.simulator.drive import Drive
from mqslam.simulator.scene import Array

BURST = 16
"""Azimuths that the radar hands over at once."""
_FIRST = 2  # place in its burst of the first azimuth of a recording
_STEADY = 0.92  # correlation of the durations of successive turns
_START_S = 0.02  # the first azimuth is measured so late that no stamp is before time zero [s]
_AT_ONCE_S, _QUEUED_S = 1e-5, (1e-4, 2.6e-4)  # between azimuths of one burst [s]
_AT_ONCE = 0.25  # share of azimuths that are stamped right after the one before them
_LAG_S = 1.5e-4  # by which a burst is late, standard deviation [s]
_WAVES = 14  # so many sines look irregular
_SLOWEST_HZ, _FASTEST_HZ = 0.15, 2.2  # a car's body on its springs
_FULL_MPS = 5.0  # from this speed on the road tilts the vehicle fully
_HAZY_AZIMUTHS = 7  # the haze of a target spreads over so many
_TO_SIGMA = 1.0 / np.sqrt(8.0 * np.log(2.0))  # of a normal curve, from its half-power width
_LEAKS = ((1.0, 1.0, 4.0), (0.2, 2.0, 8.0))  # share of the leakage, range where it ends [m], sharpness of its end [1/m]
_FAINTEST = 1e-6  # a power that no reading shows


@dataclass(frozen=True)
class JitteringClock:
    """The times of a simulated recording."""

    borders: NDArray[np.float64]  # (N + 1,) starts of the turns, and the end of the last [s]
    azimuths: int  # number of azimuths per turn
    seed: int  # of the stamps' lateness

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


@dataclass(frozen=True)
class Suspension:
    """How a vehicle pitches and rolls along a drive."""

    drive: Drive  # the drive
    realism: Realism  # how much
    rates: Array  # (2, W) of the sines of pitch and roll [Hz]
    phases: Array  # (2, W) of them [rad]

    def tip(self, times: Array, angles: Array) -> Array:
        """Returns the tip of the beam upwards (A,) [rad] at times (A,) [s], in directions (A,) [rad] against the heading."""
        speed = self.drive.twists(times)[:, 0]
        braking = (self.drive.twists(times - 0.05)[:, 0] - self.drive.twists(times + 0.05)[:, 0]) / 0.1
        waves = np.sin(2.0 * np.pi * self.rates[:, None] * times[:, None] + self.phases[:, None]).sum(axis=2)
        uneven = np.deg2rad(self.realism.tilt_deg) * np.minimum(1.0, np.abs(speed) / _FULL_MPS)
        pitch, roll = uneven * waves / np.sqrt(_WAVES / 2.0)
        dive = np.deg2rad(self.realism.dive_deg) * np.clip(braking, -4.0, 4.0)
        return np.asarray((pitch - dive) * np.cos(angles) + roll * np.sin(angles))


def make_suspension(drive: Drive, realism: Realism, seed: int) -> Suspension:
    """Makes the suspension of the vehicle of a drive."""
    rng = np.random.default_rng([seed, 12])
    rates = rng.uniform(_SLOWEST_HZ, _FASTEST_HZ, (2, _WAVES))
    return Suspension(drive, realism, rates, rng.uniform(-np.pi, np.pi, (2, _WAVES)))


def attenuate(elevations: Array, realism: Realism) -> Array:
    """Returns the two-way loss (N,) [dB] of the beam at elevations (N,) [rad] above its middle.

    It grows quickly upwards. Downwards it reaches 6 dB soon, and then grows by 0.6 dB per degree.
    """
    degrees = np.rad2deg(elevations)
    above = 3.0 * (np.maximum(degrees, 0.0) / realism.lift_deg) ** 2
    below = np.maximum(-degrees, 0.0)
    return np.asarray(above + 6.0 * (1.0 - np.exp(-((below / 1.5) ** 2))) + np.minimum(12.0, 0.6 * below))


def receive(
    field: NDArray[np.complex128], resolution: float, realism: Realism, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Turns the complex field (A, B) of a turn into readings (A, B) uint8.

    A reading is 20 log10 of a whole number, as the real radar's are: 0, 6, 9, 12, 13, ...

    Args:
        field: sum of all echoes, of points.
        resolution: length of a range bin [m].
        realism: the receiver's faults.
        rng: generator of its noise.
    """
    sigma = realism.range_width_m * _TO_SIGMA * np.sqrt(2.0) / resolution  # of the amplitude
    seen = _blur(field, sigma) * (sigma * np.sqrt(2.0 * np.pi))  # a point of amplitude 1 keeps it at its middle
    power = seen.real**2 + seen.imag**2
    noise = _floor(power, realism, rng) + _skirt(power, resolution, realism)
    noise += _haze(power, resolution, realism) + _leak(power.shape[1], resolution, realism)
    white = rng.standard_normal((*power.shape, 2)).view(np.complex128)[..., 0]
    like_echoes = _blur(white, sigma) * np.sqrt(sigma * np.sqrt(np.pi))  # mean power 1 once more
    seen += np.sqrt(noise) * like_echoes
    counts = np.floor(seen.real**2 + seen.imag**2)
    readings = COUNTS_PER_DECADE * np.log10(np.maximum(counts, 1.0))
    return np.asarray(np.minimum(255.0, readings), dtype=np.uint8)


def _blur(field: NDArray[np.complex128], sigma: float) -> NDArray[np.complex128]:
    """Filters a field (A, B) along range by a normal curve of area 1."""
    return np.asarray(gaussian_filter1d(field, sigma, axis=1, mode="constant", truncate=2.8))


def _floor(power: NDArray[np.float64], realism: Realism, rng: np.random.Generator) -> NDArray[np.float64]:
    """Returns the noise (A, 1) of each azimuth: the receiver's own, and a streak where a target is very strong."""
    count = len(power)
    own = realism.noise * (1.0 + realism.noise_varies * rng.uniform(-1.0, 1.0, count))
    streak = 10.0 ** (-realism.streak_db / 10.0) * power.max(axis=1)
    return np.asarray((own + streak * np.exp(realism.streak_varies * rng.standard_normal(count)))[:, None])


def _skirt(power: NDArray[np.float64], resolution: float, realism: Realism) -> NDArray[np.float64]:
    """Returns the phase noise (A, B) beside strong targets: the largest of what all targets of an azimuth leave."""
    fall = np.arange(power.shape[1]) * (resolution / realism.skirt_m)
    level = np.log(np.maximum(power, _FAINTEST))
    behind = np.maximum.accumulate(level + fall, axis=1) - fall
    before = np.maximum.accumulate((level - fall)[:, ::-1], axis=1)[:, ::-1] + fall
    beside = np.exp(np.maximum(behind, before))
    return np.asarray(10.0 ** (-realism.skirt_db / 10.0) * np.maximum(beside - power, 0.0))


def _haze(power: NDArray[np.float64], resolution: float, realism: Realism) -> NDArray[np.float64]:
    """Returns the diffuse multipath (A, B) behind targets, in their azimuth and those beside it."""
    share = 10.0 ** (-realism.haze_db / 10.0) * resolution / realism.range_width_m
    trail = lfilter([share], [1.0, -np.exp(-resolution / realism.haze_m)], power, axis=1)
    return np.asarray(uniform_filter1d(trail, _HAZY_AZIMUTHS, axis=0, mode="wrap")).clip(0.0)


def _leak(bins: int, resolution: float, realism: Realism) -> NDArray[np.float64]:
    """Returns the power (B,) that leaks from the transmitter into the first metres."""
    ranges = (np.arange(bins) + 0.5) * resolution
    parts = [share / (1.0 + np.exp(np.minimum(50.0, (ranges - end) * sharp))) for share, end, sharp in _LEAKS]
    return np.asarray(realism.leakage * np.sum(parts, axis=0))
