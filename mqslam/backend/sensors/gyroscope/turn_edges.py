"""The turns that a gyroscope adds to the pose graph, and the variables of its bias and scale."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, X
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.factors.gyroscope_turn import GyroscopeTurn, bias_walk, gyroscope_turn

_LEAST_WALK: Final = 1e-8  # numerical: a bias that does not walk at all would tie its variables without error [rad/s]
_CONSTANT: Final = 1e-8  # numerical: the same for the scale, which is one for the whole run


@dataclass(frozen=True, slots=True)
class TurnEdges:
    """The turns of a gyroscope between successive scans.

    Args:
        turns: (N,) with sign and clock put right [rad]; NaN where there is none.
        lasts: (N,) durations [s].
        sigmas: (N,) standard deviations [rad].
        knots: (N,) number of the bias that each turn has.
        walks: (K - 1,) standard deviations by which each bias differs from the one before it [rad/s].
        bias, scale_error: where the optimisation begins [rad/s], [1].
        sigma_bias, sigma_scale: standard deviations of their priors [rad/s], [1].
    """

    turns: NDArray[np.float64]
    lasts: NDArray[np.float64]
    sigmas: NDArray[np.float64]
    knots: NDArray[np.int64]
    walks: NDArray[np.float64]
    bias: float
    scale_error: float
    sigma_bias: float
    sigma_scale: float

    @property
    def count(self) -> int:
        """Number of turns that are known."""
        return int(np.isfinite(self.turns).sum())

    def list_factors(self, chain: se2.Array) -> Iterator[gtsam.NonlinearFactor]:
        """Yields the factors of the turns, of the walk of the bias, and its prior.

        Args:
            chain: (N + 1, 3) poses of the scans, whose yaws are right to within half a turn.
        """
        for k in np.flatnonzero(np.isfinite(self.turns)).tolist():
            turn = GyroscopeTurn(float(self.turns[k]), float(self.lasts[k]), float(self.sigmas[k]))
            yield gyroscope_turn(X(k), X(k + 1), C(int(self.knots[k])), turn, (chain[k, 2], chain[k + 1, 2]))
        for j, walk in enumerate(self.walks.tolist()):
            yield bias_walk(C(j), C(j + 1), max(walk, _LEAST_WALK), _CONSTANT)
        sigmas = gtsam.noiseModel.Diagonal.Sigmas(np.array([self.sigma_bias, self.sigma_scale]))
        yield gtsam.PriorFactorVector(C(0), np.zeros(2), sigmas)

    def insert_into(self, values: gtsam.Values) -> None:
        """Inserts the variables c0 .. of bias and scale error, from which the optimisation begins."""
        for j in range(len(self.walks) + 1):
            values.insert(C(j), np.array([self.bias, self.scale_error]))
