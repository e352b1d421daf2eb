"""How far the sensor's motion is from what the motion model can follow.

What the model leaves out (potholes, a gear change, a jittering truth) shows in how relative motions jump from revolution
to revolution beyond what their covariance explains. Third differences of the poses are used: steady speed, acceleration
and turning drop out of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.config import TrackerConfig
from mqslam.core.measurement import Measurement

_MEMORY = 40  # scans the estimate looks back on
_ENOUGH = 8  # third differences whose median is worth something
_MEDIAN_OF_CHI2 = 0.4549  # of a chi-square with one degree of freedom, to turn a median of squares into a variance
_GAIN = 10.0  # variance of a third difference of poses over that of a first one, for poses that err independently
# how much of the jumps ends up as error of a relative motion, measured on the twin and the simulator (BENCHMARKS.md);
# sideways jumps hardly show, because vy is held, and are taken from the forward ones
_FORWARD, _SIDEWAYS, _YAW = 1.7, 0.5, 1.0


class Unsteadiness:
    """Variance of relative motions that the motion model leaves out, from the last scans.

    Args:
        settings: the process noise, which stands in while too few motions are known: an acceleration that changes as much as
            it can within a scan.
        revolution_s: duration of a turn [s].
    """

    def __init__(self, settings: TrackerConfig, revolution_s: float) -> None:
        change = [0.5 * settings.sigma_ax * revolution_s, settings.sigma_vy, 0.5 * settings.sigma_alpha * revolution_s]
        self._unknown = np.square(change) * revolution_s**2
        self._motions: list[NDArray[np.float64]] = []
        self._squares: list[NDArray[np.float64]] = []
        self._expected: list[NDArray[np.float64]] = []

    def add(self, motion: Measurement) -> None:
        """Take the next relative motion; motions that were lost say nothing and are left out."""
        self._motions = [*self._motions[-2:], motion.pose]
        if len(self._motions) == 3:
            a, b, c = self._motions
            self._squares = [*self._squares[-_MEMORY + 1 :], (c - 2.0 * b + a) ** 2 / _GAIN]
            self._expected = [*self._expected[-_MEMORY + 1 :], np.diag(motion.covariance)]

    @property
    def variance(self) -> NDArray[np.float64]:
        """(3,) of x [m^2], y [m^2], yaw [rad^2]; with less than eight differences the process noise takes part."""
        known = min(1.0, len(self._squares) / _ENOUGH)
        unknown = (1.0 - known) * self._unknown
        if not self._squares:
            return np.asarray(unknown)
        seen = np.median(self._squares, axis=0) / _MEDIAN_OF_CHI2
        x, _, yaw = np.maximum(seen - np.median(self._expected, axis=0), 0.0)
        return np.asarray(unknown + known * np.array([_FORWARD**2 * x, _SIDEWAYS**2 * x, _YAW**2 * yaw]))
