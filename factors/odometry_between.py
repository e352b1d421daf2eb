"""The between-factor of odometry, with noise as large as its disagreement with psi says."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.config import GraphConfig
from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.factors.noise import between_noise


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
    """
    duration = odometry[-1].t1 - odometry[0].t0
    count = max(1, min(len(odometry), round(len(odometry) * span_s / max(duration, 1e-9))))
    misses = []
    for begin in range(0, len(odometry) - count + 1, max(1, count // 2)):
        span = slice(begin, begin + count)
        miss = se2.between(_chained(measured[span]), _chained(odometry[span]))
        miss[2] = se2.wrap(miss[2])
        misses.append(miss)
    squares = np.median(np.square(misses), axis=0) / 0.4549  # median of a chi-square with one degree of freedom
    return np.diag(squares * len(odometry) / count + 1e-10)


def _chained(motions: Sequence[Measurement]) -> se2.Array:
    pose = np.zeros(3)
    for motion in motions:
        pose = se2.compose(pose, motion.pose)
    return pose
