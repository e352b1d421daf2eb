"""Estimates the pose of the radar on the vehicle from odometry, compares it with the stated pose, and describes it in words.

The radar and the vehicle turn by the same angle. Since the front end measures this angle far more accurately than wheel
odometry, the front end's yaw is used for both. Turns show the position of the radar relative to the point whose motion
odometry reports: a radar ahead of the point moves sideways in a turn, and a radar to the left of it moves slower in a left
turn. Any drive shows the radar's yaw, since the vehicle moves along its own x axis. The point of wheel odometry is usually
halfway between the rear wheels. If the tyres slip sideways in fast turns, the estimate of this point shifts.

    travel of the radar = R (scale * travel of the vehicle + travel of the mount's position by the turn)

where R rotates from the vehicle's axes to the radar's axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.sensors.calibration import (
    AT_ORIGIN,
    DELAY_S,
    FEWEST,
    MOUNT_M,
    SIGMA_MOUNT_M,
    SIGMA_MOUNT_RAD,
    SPAN_S,
    Design,
    Motions,
    differentiate_motions,
    fit,
    measure_disagreement,
    measure_noise,
)
from mqslam.config import OdometryConfig
from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.core.sensors import Mount
from mqslam.core.wording import left_or_right
from mqslam.errors import Remedy

# Standard deviation [m] of the estimated position of the radar by errors of psi that are the same whenever the vehicle
# turns: 0.015 to 0.028 was found in simulated streets. Its square is added to the variance by random errors.
_COMMON_M = 0.03
# Standard deviation [rad] of the estimated yaw of the radar by the same errors: 0.0001 to 0.0005 was found in these streets.
_COMMON_RAD = 0.0005

_ROUNDS: Final = 10  # rounds of fit and noise; they settle in fewer
_LEAST_VARIANCE: Final = 1e-10  # numerical: keeps the weights finite for motions that agree exactly


@dataclass(frozen=True, slots=True)
class MountEstimate:
    """The pose of the radar on the vehicle, as odometry shows it.

    Args:
        pose: (3,) pose of the radar in the vehicle's frame [m, m, rad].
        sigmas: (3,) standard deviations of the pose along the vehicle's axes and in yaw [m, m, rad].
    """

    pose: se2.Array
    sigmas: NDArray[np.float64]


def estimate_mount(
    odometry: Sequence[Measurement],
    measured: Sequence[Measurement],
    stated: OdometryConfig,
    mount: se2.Array = AT_ORIGIN,
) -> MountEstimate | None:
    """Estimates the pose of the radar on the vehicle; None without odometry or with too few converged motions.

    A stated mount does not influence the estimate, so that the two can be compared.

    Args:
        odometry: motions of odometry, converted to motions of the radar.
        measured: motions of the front end over the same scans.
        stated: the settings of odometry, which state its errors.
        mount: (3,) pose of the radar on the vehicle [m, m, rad], with which odometry's motions were converted.
    """
    (seen, _, variances, converged), (given, lasts, noise, _) = Motions.of(measured), Motions.of(odometry)
    if not odometry or converged.sum() < FEWEST:
        return None
    variances = variances + _LEAST_VARIANCE
    twists = se2.log(se2.compose(se2.compose(mount, given), se2.inverse(mount)))
    twists[:, 2] = seen[:, 2]
    vehicle = se2.exp(twists)  # the vehicle's motions with the front end's turns, which also bend the travel
    span = max(1, min(len(odometry), round(len(odometry) * SPAN_S / max(float(lasts.sum()), 1e-9))))
    prior = np.diag(1.0 / np.square([max(stated.sigma_travel, _LEAST_VARIANCE), DELAY_S, MOUNT_M, MOUNT_M, np.pi]))
    aside = np.sum((seen[:, 0] * vehicle[:, 1] - seen[:, 1] * vehicle[:, 0])[converged])
    pose = np.array([0.0, 0.0, np.arctan2(aside, np.sum((vehicle[:, :2] * seen[:, :2])[converged]))])
    for _ in range(_ROUNDS):  # motions are not linear in the mount, and a motion that does not fit loses weight
        carried = se2.compose(se2.compose(se2.inverse(pose), vehicle), pose)
        design = Design(differentiate_motions(carried, lasts, pose), np.tile(np.arange(5), (len(vehicle), 1)))
        usual = np.array([0.0, 0.0, *se2.inverse(pose)[:2], 0.0])  # mean of the prior of the parameters
        misses = seen - carried
        misses[:, 2] = 0.0  # both motions have the front end's yaw
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


# The estimated position is used if its standard deviation along each axis is smaller than this [m]. On a drive without turns
# it is larger.
_MOUNT_KNOWN_M = 0.5
# The estimated yaw is used if its standard deviation is smaller than this [rad]; a straight drive suffices for that.
_MOUNT_KNOWN_RAD = 0.02

_BEYOND: Final = 3.0  # a stated and an estimated value that differ by more sigmas contradict each other


@dataclass(frozen=True, slots=True)
class MountUse:
    """The pose of the radar on the vehicle as a run reports it, stated or estimated.

    Args:
        pose: (3,) pose of the radar in the vehicle's frame [m, m, rad]; NaN for unknown components.
        sigmas: (3,) standard deviations of estimated components [m, m, rad]; NaN for stated or unknown components.
        source: `given`, `recording` or `estimated from odometry`.
        statement: sentence for the user.
        contradiction: sentence on how odometry contradicts a stated mount, or None.
    """

    pose: se2.Array
    sigmas: NDArray[np.float64]
    source: str
    statement: str
    contradiction: str | None = None


def find_mount(
    mount: Mount | None,
    odometry: Sequence[Measurement],
    measured: Sequence[Measurement],
    stated: OdometryConfig,
) -> MountUse | None:
    """Returns the stated pose of the radar on the vehicle, or else odometry's estimate; None if there is neither.

    Args:
        mount: the stated mount, or None.
        odometry: motions of odometry, converted to motions of the radar with the stated mount; empty without odometry.
        measured: motions of the front end over the same scans.
        stated: the settings of odometry, which state its errors.
    """
    estimate = estimate_mount(odometry, measured, stated, AT_ORIGIN if mount is None else mount.pose)
    limits = np.array([_MOUNT_KNOWN_M, _MOUNT_KNOWN_M, _MOUNT_KNOWN_RAD])
    if mount is not None:
        statement = f"the radar sits {_describe_pose(mount.pose)} ({mount.source})"
        contrary = None if estimate is None else _find_contrary(mount, estimate, limits)
        source, unknown = "given" if mount.given else "recording", np.full(3, np.nan)
        contradiction = None if contrary is None else f"{statement}, but {contrary}"
        return MountUse(mount.pose, unknown, source, statement, contradiction)
    if estimate is None:
        return None
    known = estimate.sigmas < limits
    known[:2] = known[:2].all()
    pose, sigmas = np.where(known, estimate.pose, np.nan), np.where(known, estimate.sigmas, np.nan)
    return MountUse(pose, sigmas, "estimated from odometry", _tell_estimate(pose, sigmas))


def _find_contrary(mount: Mount, estimate: MountEstimate, limits: NDArray[np.float64]) -> str | None:
    """Describes in words odometry's estimate if it contradicts the stated mount; returns None if the two agree.

    `limits` (3,) are the standard deviations [m, m, rad] below which a component of the estimate is compared.
    """
    own = np.array([SIGMA_MOUNT_M, SIGMA_MOUNT_M, SIGMA_MOUNT_RAD])
    known = estimate.sigmas < limits
    if not np.any(known & (np.abs(se2.subtract(estimate.pose, mount.pose)) > _BEYOND * np.hypot(own, estimate.sigmas))):
        return None
    place = _describe_pose(np.where(known, estimate.pose, np.nan), np.where(known, estimate.sigmas, np.nan))
    return f"odometry says {place}: one of the two is wrong, or the odometry tracks another point than the vehicle's origin"


def _tell_estimate(pose: se2.Array, sigmas: NDArray[np.float64]) -> str:
    """Describes in a sentence where the radar sits according to odometry, from `pose` and `sigmas` as in `MountUse`."""
    if np.isnan(pose).all():
        return "odometry does not show where the radar sits: the vehicle drives too little where the front end finds motions"
    if np.isnan(pose[0]):
        turned = _describe_pose(pose, sigmas)
        return f"odometry says that the radar is {turned}; the drive turns too little to show the radar's position"
    is_off = bool(np.any(np.abs(pose) > _BEYOND * sigmas))
    statement = f"odometry says that the radar sits {_describe_pose(pose, sigmas) if is_off else _describe_origin(sigmas)}"
    if np.isnan(pose[2]):
        return f"{statement}; it does not show the radar's yaw"
    if not is_off:
        return statement
    x, y, yaw = pose[0], pose[1], np.degrees(pose[2])
    return f"{statement}; {Remedy.GIVE_EXTRINSICS} {x:z.2f},{y:z.2f},{yaw:z.1f} to use it"


def _describe_origin(sigmas: NDArray[np.float64]) -> str:
    """Describes a radar at the vehicle's origin, with the standard deviations (3,) of its pose [m, m, rad], in words."""
    x, y, yaw = sigmas
    turned = "" if np.isnan(yaw) else f", not turned (± {np.degrees(yaw):.2g} deg)"
    return f"at the vehicle's origin (± {x:.2g} m ahead, ± {y:.2g} m to the left){turned}"


def _describe_pose(pose: se2.Array, sigmas: NDArray[np.float64] | None = None) -> str:
    """Describes in words the known components of a pose (3,) [m, m, rad] on a vehicle, and any standard deviations (3,)."""
    x, y, yaw = pose
    sure = ["", "", ""]
    if sigmas is not None:
        sure = [f" (± {sigmas[0]:.2g} m)", f" (± {sigmas[1]:.2g} m)", f" (± {np.degrees(sigmas[2]):.2g} deg)"]
    words = [
        f"{abs(x):.3g} m{sure[0]} {'ahead of' if x >= 0.0 else 'behind'} the vehicle's origin",
        f"{abs(y):.3g} m{sure[1]} to the {left_or_right(y)}",
        f"turned by {abs(np.degrees(yaw)):.3g} deg{sure[2]} to the {left_or_right(yaw)}",
    ]
    return ", ".join(word for word, value in zip(words, pose.tolist(), strict=True) if np.isfinite(value))
