"""The between-factor of odometry, with noise as large as its disagreement with psi says."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.config import GraphConfig
from mqslam.core import se2
from mqslam.core.measurement import Measurement, Status
from mqslam.factors.noise import between_noise

_MEDIAN_OF_CHI2 = 0.4549  # of a chi-square with one degree of freedom, to turn a median of squares into a variance
_LEAST_FOUND = 0.5  # share of a span's motions that psi has to have found for the span to show how far odometry is off
_FEWEST_SPANS = 5  # whose median says how large the disagreement is; that of fewer may be small by chance


def odometry_between(a: int, b: int, motion: Measurement, config: GraphConfig) -> gtsam.BetweenFactorPose2:
    """The motion from key a to key b with its own covariance."""
    noise = between_noise(motion.covariance, motion.pose[2], config.floor_m, config.floor_rad, config.huber)
    return gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(*motion.pose), noise)


def odometry_covariance(
    odometry: Sequence[Measurement], measured: Sequence[Measurement], span_s: float
) -> NDArray[np.float64]:
    """Covariance (3, 3) of one odometry edge, from what edges chained over a span [s] disagree with psi.

    Wheel odometry errs by scale and bias, so that all edges of a run err together and know no more than one span of
    them does: every edge gets the disagreement of a whole span, times the number of spans in the run. That keeps their
    sum from outvoting psi where psi measures.

    Where psi did not find a motion it took odometry's, and agrees with it for that reason: such edges show nothing. Where
    only a few spans show anything, odometry is not taken to be better than it says itself.
    """
    duration = odometry[-1].t1 - odometry[0].t0
    count = max(1, min(len(odometry), round(len(odometry) * span_s / max(duration, 1e-9))))
    found = np.array([motion.status is Status.CONVERGED for motion in measured])
    misses, stated = [], []
    for begin in range(0, len(odometry) - count + 1, max(1, count // 2)):
        span = slice(begin, begin + count)
        stated.append(np.sum([np.sqrt(np.diag(motion.covariance)) for motion in odometry[span]], axis=0))
        share = found[span].mean()
        if share >= _LEAST_FOUND:
            ends = (se2.chain(motion.pose for motion in motions[span])[-1] for motions in (measured, odometry))
            misses.append(se2.wrapped_between(*ends) / share)
    squares = np.median(np.square(misses), axis=0) / _MEDIAN_OF_CHI2 if misses else np.zeros(3)
    if len(misses) < _FEWEST_SPANS:
        squares = np.maximum(squares, np.median(np.square(stated), axis=0))
    return np.diag(squares * len(odometry) / count + 1e-10)
