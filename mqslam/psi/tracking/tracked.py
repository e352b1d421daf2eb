"""What the tracker returns for a scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.measurement import Status
from mqslam.psi.scoring.estimator import PsiEvaluation
from mqslam.psi.tracking.state import SIZE, State


@dataclass(frozen=True, slots=True)
class Tracked:
    """One scan, matched.

    Args:
        t0: its start [s].
        state: its start pose and motion.
        covariance: (3, 3) of the start pose, given the map that the scan is in, as psi's curvature shows it; zero without a
            match.
        unseen: (3, 3) what is unknown besides, of directions that psi does not observe or where there is no match.
        evaluation: psi at the minimum.
        status: how far it can be trusted.
        begins_map: whether a new map begins with it.
        arrival: (3, 3) covariance that the step to it across a gap or a loss adds to its start pose; else None.
        earlier: (3,) start pose as it was first measured, where it was measured again; else None.
    """

    t0: float
    state: State
    covariance: NDArray[np.float64]
    unseen: NDArray[np.float64]
    evaluation: PsiEvaluation
    status: Status
    begins_map: bool = False
    arrival: NDArray[np.float64] | None = None
    earlier: se2.Array | None = None

    @property
    def pose(self) -> se2.Array:
        """(3,) start pose."""
        return self.state.pose


def make_empty_evaluation() -> PsiEvaluation:
    """Returns the evaluation of no returns at all, for a scan that there was no map for."""
    return PsiEvaluation(
        np.zeros(0), np.zeros(0, dtype=bool), np.zeros((0, SIZE)), np.zeros((SIZE, SIZE)), np.zeros((SIZE, SIZE))
    )
