"""How sure the state of a matched scan is: as a measurement, and as what the next prediction starts from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mqslam.psi.covariance import estimate_covariance
from mqslam.psi.gaussians import fuse, invert_information
from mqslam.psi.minimiser import STABILISER
from mqslam.psi.place import PointSet
from mqslam.psi.scoring.estimator import PsiEvaluation
from mqslam.psi.tracking.dynamics import SIGMA_AX, SIGMA_VY, drop_directions
from mqslam.psi.tracking.local_map import LocalMap
from mqslam.psi.tracking.setup import Setup
from mqslam.psi.tracking.state import ALPHA, AX, SIZE, TOLERANCES, VY, YAW, Belief, State


def measure_covariance(
    evaluation: PsiEvaluation, placed: PointSet, predicted: Belief, into: LocalMap, setup: Setup
) -> NDArray[np.float64]:
    """Returns the covariance (8, 8) of a match by psi's curvature; what psi does not observe is as sure as the prediction.

    Args:
        evaluation: psi at the match.
        placed: the scan's points there.
        predicted: the prediction that the match began with.
        into: the map.
        setup: settings of the tracker and of the score.
    """
    settings, correlation = setup.settings, setup.tuning.correlation
    known = np.zeros((SIZE, SIZE))  # a vehicle hardly slides: without this, vy would seem as free as vx
    known[VY, VY] = correlation / SIGMA_VY**2
    known[AX, AX] = correlation / SIGMA_AX**2
    known[ALPHA, ALPHA] = correlation / settings.sigma_alpha**2
    thin = 1.0 + 1.0 / max(len(into), 1)  # the map's points err like the scan's, but several keyframes average their errors
    measured = estimate_covariance(evaluation, placed.points, setup.estimator.cluster_m, known)
    return fuse(thin * measured, predicted.covariance, TOLERANCES)


def update_belief(
    vector: NDArray[np.float64],
    evaluation: PsiEvaluation,
    prior_information: NDArray[np.float64],
    setup: Setup,
    weak: NDArray[np.float64] | None = None,
) -> Belief:
    """Returns what is known of a state after a match, as the next prediction starts from it.

    Args:
        vector: (8,) the state at the match.
        evaluation: psi there.
        prior_information: (8, 8) of the prediction.
        setup: how a track is matched.
        weak: (K, 3) directions of the start pose that psi does not observe, along which only the prediction counts; None
            where it observes all.
    """
    information = (evaluation.curvature + STABILISER * evaluation.information) / setup.tuning.correlation
    if weak is not None:
        information = drop_directions(information, weak, float(vector[YAW]))
    units = TOLERANCES[:, None] * TOLERANCES[None, :]
    values, vectors = np.linalg.eigh(information * units)
    safe = (vectors * np.maximum(values, 0.0)) @ vectors.T / units
    return Belief(State(vector), invert_information(safe + prior_information, TOLERANCES))
