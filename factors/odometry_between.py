"""The between-factor of odometry, with noise as large as its disagreement with psi."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.config import GraphConfig
from mqslam.core import se2
from mqslam.core.measurement import Measurement, Status
from mqslam.factors.noise import between_noise

MEDIAN_OF_CHI2: Final = 0.4549
"""Median of a chi-square with one degree of freedom, by definition: it turns a median of squares into a variance."""
_LEAST_VARIANCE: Final = 1e-10  # numerical: keeps the covariance of odometry that agrees exactly from being singular


def odometry_between(a: int, b: int, motion: Measurement, config: GraphConfig) -> gtsam.BetweenFactorPose2:
    """Returns the factor of an odometry motion with its own covariance.

    Args:
        a: key of the pose at the motion's begin.
        b: key of the pose at its end.
        motion: the measurement.
        config: settings of the graph.
    """
    noise = between_noise(motion.covariance, motion.pose[2], config.huber)
    return gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(*motion.pose), noise)


def estimate_odometry_covariance(
    odometry: Sequence[Measurement], measured: Sequence[Measurement], config: GraphConfig
) -> NDArray[np.float64]:
    """Returns the covariance (3, 3) of one odometry edge, from how far chains of edges disagree with psi.

    Wheel odometry errs by scale and bias, so that all edges of a run err together and know no more than the edges of one
    span do. Every edge therefore gets the disagreement of a whole span, times the number of spans in the run, which keeps
    the sum of all edges from outvoting psi where psi measures.

    Where psi did not find a motion it took odometry's and agrees with it for that reason, so that such edges show nothing.
    Where only a few spans show anything, odometry is not taken to be better than it states itself.

    Args:
        odometry: motions of odometry.
        measured: motions of the front end over the same scans.
        config: settings of the graph.
    """
    duration = odometry[-1].t1 - odometry[0].t0
    count = max(1, min(len(odometry), round(len(odometry) * config.odometry_span_s / max(duration, 1e-9))))
    converged = np.array([motion.status is Status.CONVERGED for motion in measured])
    misses, stated = [], []
    for begin in range(0, len(odometry) - count + 1, max(1, count // 2)):
        span = slice(begin, begin + count)
        stated.append(np.sum([np.sqrt(np.diag(motion.covariance)) for motion in odometry[span]], axis=0))
        share = converged[span].mean()
        if share >= config.odometry_span_share:
            ends = (se2.chain(motion.pose for motion in motions[span])[-1] for motions in (measured, odometry))
            misses.append(se2.wrapped_between(*ends) / share)
    squares = np.median(np.square(misses), axis=0) / MEDIAN_OF_CHI2 if misses else np.zeros(3)
    if len(misses) < config.odometry_fewest_spans:
        squares = np.maximum(squares, np.median(np.square(stated), axis=0))
    return np.diag(squares * len(odometry) / count + _LEAST_VARIANCE)
