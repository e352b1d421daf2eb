"""What the receiver makes of the echoes of a turn: the width of a point along range, noise in all its forms, readings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, uniform_filter1d
from scipy.signal import lfilter
from worlds.hard.realism import Realism

from mqslam.simulator.beam import COUNTS_PER_DECADE

_HAZY_AZIMUTHS = 7  # the haze of a target spreads over so many
_TO_SIGMA = 1.0 / np.sqrt(8.0 * np.log(2.0))  # of a normal curve, from its half-power width
_LEAKS = ((1.0, 1.0, 4.0), (0.2, 2.0, 8.0))  # share of the leakage, range where it ends [m], sharpness of its end [1/m]
_FAINTEST = 1e-6  # a power that no reading shows


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
