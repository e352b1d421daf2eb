"""How far a revolution's motion is from the constant twist it is modelled by.

What the model cannot follow shows in how the twist jumps from revolution to revolution, beyond what its own covariance
explains. Second differences are used, because steady acceleration does no harm: it shifts all poses alike.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_MEMORY = 40  # revolutions the estimate looks back on
_MEDIAN_OF_CHI2 = 0.4549  # of a chi-square with one degree of freedom, to turn a median of squares into a variance


class Unsteadiness:
    """Variance of the twist that a constant twist per revolution leaves out, from the last revolutions."""

    def __init__(self) -> None:
        self._twists: list[NDArray[np.float64]] = []
        self._squares: list[NDArray[np.float64]] = []
        self._expected: list[NDArray[np.float64]] = []

    def add(self, twist: NDArray[np.float64], variances: NDArray[np.float64]) -> None:
        """Take the next revolution's twist (3,) and the variances (3,) its covariance gives it."""
        self._twists = [*self._twists[-2:], twist]
        if len(self._twists) == 3:
            a, b, c = self._twists
            self._squares = [*self._squares[-_MEMORY + 1 :], (c - 2.0 * b + a) ** 2 / 3.0]
            self._expected = [*self._expected[-_MEMORY + 1 :], 2.0 * variances]

    @property
    def variance(self) -> NDArray[np.float64]:
        """(3,) of vx [m^2/s^2], vy [m^2/s^2], omega [rad^2/s^2]; zero as long as too little is known."""
        if not self._squares:
            return np.zeros(3)
        seen = np.median(self._squares, axis=0) / _MEDIAN_OF_CHI2
        return np.asarray(np.maximum(seen - np.median(self._expected, axis=0), 0.0))
