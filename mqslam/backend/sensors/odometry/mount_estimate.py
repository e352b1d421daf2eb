"""Where the radar sits on the vehicle, estimated from wheel odometry and psi's motions.

The radar and the vehicle turn alike, so that psi's yaw, which is far better than that of wheels, stands for both. The place
then shows in turns: a radar ahead of the point that odometry follows moves sideways there, one to its left moves slower in
a left turn. The yaw shows wherever the vehicle drives: it goes along its own x axis. The point is the one that the wheels
report the motion of, usually the middle between the rear wheels; a vehicle whose tyres slip sideways in fast turns seems to
have it elsewhere.

    travel of the radar = turn back by the mount's yaw (scale * travel of the vehicle + swing of the mount's place)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.sensors.odometry.odometry_calibration import (
    AT_ORIGIN,
    DELAY_S,
    FEWEST,
    MOUNT_M,
    SPAN_S,
    Design,
    differentiate_motions,
    fit,
)
from mqslam.backend.sensors.odometry.odometry_noise import measure_disagreement, measure_noise
from mqslam.config import OdometryConfig
from mqslam.core import se2
from mqslam.core.measurement import Measurement, Status

# Standard deviation of what psi itself gets wrong in all turns alike, as a place of the radar [m]: 0.015 to 0.028 was found
# in simulated streets. An estimate states it beside what scatters from motion to motion.
_COMMON_M = 0.03
# The same of the yaw [rad]: 0.0001 to 0.0005 was found in these streets.
_COMMON_RAD = 0.0005

_ROUNDS: Final = 10  # rounds of fit and noise, which settle in fewer
_LEAST_VARIANCE: Final = 1e-10  # numerical: keeps the weights of motions that agree exactly finite


@dataclass(frozen=True, slots=True)
class MountEstimate:
    """Where odometry says the radar sits.

    Args:
        pose: (3,) of the radar in the vehicle's frame [m, m, rad].
        sigmas: (3,) standard deviations: along the vehicle's axes, and of the yaw.
    """

    pose: se2.Array
    sigmas: NDArray[np.float64]


def estimate_mount(
    odometry: Sequence[Measurement],
    measured: Sequence[Measurement],
    stated: OdometryConfig,
    mount: se2.Array = AT_ORIGIN,
) -> MountEstimate | None:
    """Estimates where the radar sits, from motions that psi found itself; None where these are too few.

    What is stated about the mount takes no part, so that the estimate can be held against it.

    Args:
        odometry: motions of odometry.
        measured: motions of the front end over the same scans.
        stated: the errors that odometry states.
        mount: (3,) pose of the radar on the vehicle, by which the motions of odometry were carried to the radar.
    """
    converged = np.array([motion.status is Status.CONVERGED for motion in measured], dtype=bool)
    if not odometry or converged.sum() < FEWEST:
        return None
    seen, told = (np.array([motion.pose for motion in motions]) for motions in (measured, odometry))
    lasts = np.array([motion.t1 - motion.t0 for motion in odometry])
    vehicle = _turn_alike(se2.compose(se2.compose(mount, told), se2.inverse(mount)), seen)
    span = max(1, min(len(odometry), round(len(odometry) * SPAN_S / max(float(lasts.sum()), 1e-9))))
    variances = np.array([np.diag(motion.covariance) for motion in measured]) + _LEAST_VARIANCE
    noise = np.array([np.diag(motion.covariance) for motion in odometry])
    prior = np.diag(1.0 / np.square([max(stated.sigma_travel, _LEAST_VARIANCE), DELAY_S, MOUNT_M, MOUNT_M, np.pi]))
    pose = np.array([0.0, 0.0, _find_yaw(vehicle[converged], seen[converged])])
    for _ in range(_ROUNDS):  # the place and the yaw are not linear in the motions, and those that fit none lose weight
        carried = se2.compose(se2.compose(se2.inverse(pose), vehicle), pose)
        design = Design(differentiate_motions(carried, lasts, pose), np.tile(np.arange(5), (len(vehicle), 1)), np.empty(0))
        usual = np.array([0.0, 0.0, *se2.inverse(pose)[:2], 0.0])  # where the prior expects the parameters
        misses = seen - carried
        misses[:, 2] = 0.0  # both yaws are psi's
        misses[~converged] = np.nan
        found = fit(design, misses - design.jacobians @ usual, variances, noise, prior)
        parameters = found.parameters + usual
        residuals = misses - design.jacobians @ parameters
        common = measure_noise(residuals, variances, span)
        noise = common + measure_disagreement(residuals, variances, common, span) + _LEAST_VARIANCE
        pose = se2.compose(pose, parameters[2:])
    turned = se2.rotate_covariance(found.covariance[2:, 2:], float(pose[2]))
    alike = np.array([_COMMON_M, _COMMON_M, _COMMON_RAD])
    pose[2] = se2.wrap(pose[2])
    return MountEstimate(pose, np.hypot(np.sqrt(np.diag(turned)), alike))


def _turn_alike(vehicle: se2.Array, seen: se2.Array) -> se2.Array:
    """Returns motions (N, 3) of the vehicle with the yaws of the radar's (N, 3), and bends their travel alike."""
    twists = se2.log(vehicle)
    twists[:, 2] = seen[:, 2]
    return se2.exp(twists)


def _find_yaw(vehicle: se2.Array, seen: se2.Array) -> float:
    """Returns the yaw [rad] of the radar on the vehicle that turns the travel of one (N, 3) into that of the other best."""
    turned = np.sum(seen[:, 0] * vehicle[:, 1] - seen[:, 1] * vehicle[:, 0])
    return float(np.arctan2(turned, np.sum(vehicle[:, :2] * seen[:, :2])))
