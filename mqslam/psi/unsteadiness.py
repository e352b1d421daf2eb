"""How far the sensor's motion is from what the motion model can follow.

What the model leaves out (potholes, a gear change, a jittering truth) shows in how relative motions jump from scan to scan
beyond what their covariance explains. Third differences of the poses are used: steady speed, acceleration and turning drop
out of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.config import TrackerConfig
from mqslam.core.measurement import Measurement

_MEDIAN_OF_CHI2 = 0.4549  # median of a chi-square with one degree of freedom: it turns a median of squares into a variance
_GAIN = 10.0  # variance of a third difference of poses over that of a first one, for poses that err independently: 20 / 2


class Unsteadiness:
    """Variance of relative motions that the motion model leaves out, from the last scans.

    Args:
        settings: how it is estimated, and the process noise, which stands in while too few motions are known: an
            acceleration that changes as much as it can within a scan.
        revolution_s: duration of a turn [s].
    """

    def __init__(self, settings: TrackerConfig, revolution_s: float) -> None:
        change = [0.5 * settings.sigma_ax * revolution_s, settings.sigma_vy, 0.5 * settings.sigma_alpha * revolution_s]
        self._settings = settings
        self._unknown = np.square(change) * revolution_s**2
        self._motions: list[NDArray[np.float64]] = []
        self._squares: list[NDArray[np.float64]] = []
        self._expected: list[NDArray[np.float64]] = []

    def add(self, motion: Measurement) -> None:
        """Takes the next relative motion; motions of a lost track should be left out."""
        self._motions = [*self._motions[-2:], motion.pose]
        if len(self._motions) == 3:
            a, b, c = self._motions
            memory = self._settings.unsteady_scans
            self._squares = [*self._squares, (c - 2.0 * b + a) ** 2 / _GAIN][-memory:]
            self._expected = [*self._expected, np.diag(motion.covariance)][-memory:]

    @property
    def variance(self) -> NDArray[np.float64]:
        """(3,) of x [m^2], y [m^2], yaw [rad^2]; while too few motions are known the process noise takes part."""
        settings = self._settings
        known = min(1.0, len(self._squares) / settings.unsteady_least)
        unknown = (1.0 - known) * self._unknown
        if not self._squares:
            return np.asarray(unknown)
        median = np.median(self._squares, axis=0) / _MEDIAN_OF_CHI2
        x, _, yaw = np.maximum(median - np.median(self._expected, axis=0), 0.0)
        forward, sideways, turn = settings.unsteady_forward, settings.unsteady_sideways, settings.unsteady_yaw
        return np.asarray(unknown + known * np.array([forward**2 * x, sideways**2 * x, turn**2 * yaw]))
