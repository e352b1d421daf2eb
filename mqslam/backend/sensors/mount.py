"""Where the radar sits on the vehicle: what is stated and what odometry says of it, in numbers and in words.

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
    (seen, _, variances, converged), (given, lasts, noise, _) = Motions.of(measured), Motions.of(odometry)
    if not odometry or converged.sum() < FEWEST:
        return None
    variances = variances + _LEAST_VARIANCE
    twists = se2.log(se2.compose(se2.compose(mount, given), se2.inverse(mount)))
    twists[:, 2] = seen[:, 2]
    vehicle = se2.exp(twists)  # turns as the radar does, and its travel bends alike
    span = max(1, min(len(odometry), round(len(odometry) * SPAN_S / max(float(lasts.sum()), 1e-9))))
    prior = np.diag(1.0 / np.square([max(stated.sigma_travel, _LEAST_VARIANCE), DELAY_S, MOUNT_M, MOUNT_M, np.pi]))
    aside = np.sum((seen[:, 0] * vehicle[:, 1] - seen[:, 1] * vehicle[:, 0])[converged])
    pose = np.array([0.0, 0.0, np.arctan2(aside, np.sum((vehicle[:, :2] * seen[:, :2])[converged]))])
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


# The radar's place on the vehicle is stated as an estimate if its standard deviation along each axis is smaller than this
# [m]; without turns it is not.
_MOUNT_KNOWN_M = 0.5
# The same of the yaw at which the radar is mounted [rad], for which driving straight suffices.
_MOUNT_KNOWN_RAD = 0.02

_BEYOND: Final = 3.0  # two statements that are farther apart than so many standard deviations disagree


@dataclass(frozen=True, slots=True)
class MountUse:
    """Where the radar sits on the vehicle.

    Args:
        pose: (3,) of the radar in the vehicle's frame [m, m, rad]; NaN where it is not known.
        sigmas: (3,) standard deviations of an estimate; NaN where the pose is stated or not known.
        source: `given`, `recording` or `estimated from odometry`.
        statements: what a user should know, in whole sentences.
        contradiction: what odometry says against a stated mount, or None.
    """

    pose: se2.Array
    sigmas: NDArray[np.float64]
    source: str
    statements: tuple[str, ...]
    contradiction: str | None = None


def find_mount(
    mount: Mount | None,
    odometry: Sequence[Measurement],
    measured: Sequence[Measurement],
    stated: OdometryConfig,
) -> MountUse | None:
    """Finds where the radar sits: where it is stated to be, or else where odometry says; None where nothing says anything.

    Args:
        mount: that is stated, or None.
        odometry: motions of odometry, carried to the radar by the stated mount.
        measured: motions of the front end over the same scans.
        stated: the errors of odometry and of a stated mount.
    """
    estimate = estimate_mount(odometry, measured, stated, AT_ORIGIN if mount is None else mount.pose)
    limits = np.array([_MOUNT_KNOWN_M, _MOUNT_KNOWN_M, _MOUNT_KNOWN_RAD])
    if mount is not None:
        statement = f"the radar sits {_describe_pose(mount.pose)} ({mount.source})"
        contrary = None if estimate is None else _find_contrary(mount, estimate, limits)
        source, unknown = "given" if mount.given else "recording", np.full(3, np.nan)
        return MountUse(
            mount.pose, unknown, source, (statement,), None if contrary is None else f"{statement}, but {contrary}"
        )
    if estimate is None:
        return None
    known = estimate.sigmas < limits
    known[:2] = known[:2].all()
    pose, sigmas = np.where(known, estimate.pose, np.nan), np.where(known, estimate.sigmas, np.nan)
    return MountUse(pose, sigmas, "estimated from odometry", (_tell_estimate(pose, sigmas),))


def _find_contrary(mount: Mount, estimate: MountEstimate, limits: NDArray[np.float64]) -> str | None:
    """Returns what odometry says against a stated mount, as far as it knows it; None where it agrees."""
    own = np.array([SIGMA_MOUNT_M, SIGMA_MOUNT_M, SIGMA_MOUNT_RAD])
    known = estimate.sigmas < limits
    if not np.any(known & (np.abs(se2.subtract(estimate.pose, mount.pose)) > _BEYOND * np.hypot(own, estimate.sigmas))):
        return None
    place = _describe_pose(np.where(known, estimate.pose, np.nan), np.where(known, estimate.sigmas, np.nan))
    return f"odometry says {place}: one of the two is wrong, or the odometry is of another point than the vehicle's origin"


def _tell_estimate(pose: se2.Array, sigmas: NDArray[np.float64]) -> str:
    """Returns what odometry says of where the radar sits, in words."""
    if np.isnan(pose).all():
        return "where the radar sits on the vehicle cannot be told from the odometry: it drives too little that psi follows"
    if np.isnan(pose[0]):
        turned = _describe_pose(pose, sigmas)
        return f"odometry says that the radar is {turned}; where it sits cannot be told, since the drive turns too little"
    is_off = bool(np.any(np.abs(pose) > _BEYOND * sigmas))
    statement = f"odometry says that the radar sits {_describe_pose(pose, sigmas) if is_off else _describe_origin(sigmas)}"
    if np.isnan(pose[2]):
        return f"{statement}; its yaw cannot be told"
    if not is_off:
        return statement
    x, y, yaw = pose[0], pose[1], np.degrees(pose[2])
    return f"{statement}; {Remedy.GIVE_EXTRINSICS} {x:z.2f},{y:z.2f},{yaw:z.1f} to use it"


def _describe_origin(sigmas: NDArray[np.float64]) -> str:
    """Returns that a radar sits at the vehicle's origin, as far as standard deviations tell, in words."""
    x, y, yaw = sigmas
    turned = "" if np.isnan(yaw) else f", not turned (± {np.degrees(yaw):.2g} deg)"
    return f"at the vehicle's origin (± {x:.2g} m ahead, ± {y:.2g} m to the left){turned}"


def _describe_pose(pose: se2.Array, sigmas: NDArray[np.float64] | None = None) -> str:
    """Returns the parts of a pose on a vehicle that are known, in words, with standard deviations where there are any."""
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
