"""What odometry gets wrong all the time, found where psi saw the motion itself.

The motion of odometry between two scans differs from the radar's by errors that all motions share:

    motion of the radar = motion of odometry + design (3, 7) @ parameters (7,) + noise

The parameters are the scale of the travel, how late the clock of odometry is, where the radar sits in the vehicle (ahead,
to the left, turned), and the bias of the yaw rate, which may walk: it has a value at every knot and is interpolated
between two of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.config import GraphConfig, OdometryConfig
from mqslam.core import se2
from mqslam.core.measurement import Measurement

_COMMON: Final = 5  # parameters with one value for the whole run; the bias follows them
_DELAY_S: Final = 0.1  # no clock that serves at all is much later than this: the prior's standard deviation [s]
_MOUNT_M: Final = 2.0  # a radar is about as far from the point that odometry follows: the prior's standard deviation [m]
_MOST_KNOTS: Final = 1000  # numerical: the fit's matrices stay small, however long the run
_LEAST_SIGMA: Final = 1e-6  # numerical: settings may state errors of zero


@dataclass(frozen=True, slots=True)
class Design:
    """How the parameters move the motions of odometry.

    Args:
        jacobians: (N, 3, 7) of the motions by the parameters that concern them: the common ones and two knots' biases.
        columns: (N, 7) numbers of these parameters.
        knots_s: (K - 1,) time from each of the K knots to the next one [s].
    """

    jacobians: NDArray[np.float64]
    columns: NDArray[np.int64]
    knots_s: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Calibration:
    """The parameters and what is known of them.

    Args:
        parameters: (P,) scale [1], delay [s], radar ahead and to the left [m], turned [rad], bias at every knot [rad/s].
        covariance: (P, P) of them.
    """

    parameters: NDArray[np.float64]
    covariance: NDArray[np.float64]

    def correct(self, design: Design) -> NDArray[np.float64]:
        """Returns the corrections (N, 3) of the motions."""
        return np.asarray(np.einsum("kij,kj->ki", design.jacobians, self.parameters[design.columns]))

    def list_sigmas(self, design: Design) -> NDArray[np.float64]:
        """Returns the standard deviations (N, 3) of the corrections."""
        blocks = self.covariance[design.columns[:, :, None], design.columns[:, None, :]]
        variances = np.einsum("kij,kjl,kil->ki", design.jacobians, blocks, design.jacobians)
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)))


def make_design(motions: Sequence[Measurement], span: int) -> Design:
    """Returns how the parameters move the motions of odometry, to first order.

    Args:
        motions: two or more, one after the other.
        span: number of motions from a knot of the bias to the next one.
    """
    poses = np.array([motion.pose for motion in motions])
    lasts = np.array([motion.t1 - motion.t0 for motion in motions])
    x, y, yaw = poses.T
    jacobians = np.zeros((len(motions), 3, _COMMON + 2))
    jacobians[:, :2, 0] = poses[:, :2]
    # the twist at a scan's start is the mean of those before and after it
    jacobians[:, :, 1] = np.gradient(se2.log(poses) / lasts[:, None], axis=0)
    jacobians[:, :2, 2] = np.column_stack([np.cos(yaw) - 1.0, np.sin(yaw)])
    jacobians[:, :2, 3] = np.column_stack([-np.sin(yaw), np.cos(yaw) - 1.0])
    jacobians[:, :2, 4] = np.column_stack([y, -x])
    by_bias = np.column_stack([-0.5 * y * lasts, 0.5 * x * lasts, lasts])
    span = max(span, -(-len(motions) // _MOST_KNOTS))
    at = (np.arange(len(motions)) + 0.5) / span
    left = at.astype(np.int64)
    jacobians[:, :, _COMMON] = by_bias * (left + 1 - at)[:, None]
    jacobians[:, :, _COMMON + 1] = by_bias * (at - left)[:, None]
    common = np.tile(np.arange(_COMMON), (len(motions), 1))
    columns = np.column_stack([common, _COMMON + left, _COMMON + left + 1])
    knots_s = np.add.reduceat(lasts, np.arange(0, len(motions), span))
    return Design(jacobians, columns, np.maximum(knots_s, span * np.median(lasts)))  # the last knot is past the end


def make_prior_information(design: Design, stated: OdometryConfig, settings: GraphConfig) -> NDArray[np.float64]:
    """Returns the information (P, P) that odometry states about its parameters, which are zero as far as it knows."""
    sigmas = [stated.sigma_travel, _DELAY_S, _MOUNT_M, _MOUNT_M, stated.sigma_travel, stated.sigma_yaw_rate]
    information = np.zeros((_COMMON + len(design.knots_s) + 1,) * 2)
    first = np.arange(_COMMON + 1)
    information[first, first] = 1.0 / np.square(np.maximum(sigmas, _LEAST_SIGMA))
    for knot, step_s in enumerate(design.knots_s, start=_COMMON):
        step = np.array([[1.0, -1.0], [-1.0, 1.0]]) / (settings.odometry_bias_walk**2 * step_s)
        information[knot : knot + 2, knot : knot + 2] += step
    return information


def fit(
    design: Design, misses: NDArray[np.float64], variances: NDArray[np.float64], prior: NDArray[np.float64]
) -> Calibration:
    """Fits the parameters by weighted least squares.

    Args:
        design: of all motions.
        misses: (N, 3) what the radar's motion has more than odometry's; NaN where psi did not find it itself.
        variances: (N, 3) of the misses.
        prior: (P, P) information about the parameters.
    """
    weights = np.where(np.isfinite(misses), 1.0 / variances, 0.0)
    information, right = prior.copy(), np.zeros(len(prior))
    weighted = design.jacobians * weights[:, :, None]
    blocks = np.einsum("kij,kil->kjl", weighted, design.jacobians)
    np.add.at(information, (design.columns[:, :, None], design.columns[:, None, :]), blocks)
    np.add.at(right, design.columns, np.einsum("kij,ki->kj", weighted, np.nan_to_num(misses)))
    covariance = np.linalg.inv(information)
    return Calibration(covariance @ right, 0.5 * (covariance + covariance.T))
