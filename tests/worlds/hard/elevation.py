"""The beam in elevation: its pattern, and how the vehicle's pitch and roll tip it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from worlds.hard.realism import Realism

from mqslam.simulator.drive import Drive, Times
from mqslam.simulator.scene import Array

_WAVES = 14  # so many sines look irregular
_SLOWEST_HZ, _FASTEST_HZ = 0.15, 2.2  # a car's body on its springs
_FULL_MPS = 5.0  # from this speed on the road tilts the vehicle fully


@dataclass(frozen=True)
class Suspension:
    """How a vehicle pitches and rolls along a drive.

    Args:
        drive: the drive.
        realism: how much.
        rates: (2, W) of the sines of pitch and roll [Hz].
        phases: (2, W) of them [rad].
    """

    drive: Drive
    realism: Realism
    rates: Array
    phases: Array

    def tip(self, times: Times, angles: Array) -> Array:
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
