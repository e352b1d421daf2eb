"""Where the radar sits on the vehicle: what is stated and what odometry says of it, in numbers and in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.sensors.odometry.mount_estimate import MountEstimate, estimate_mount
from mqslam.backend.sensors.odometry.odometry_calibration import AT_ORIGIN, SIGMA_MOUNT_M, SIGMA_MOUNT_RAD
from mqslam.config import OdometryConfig
from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.core.sensors.mount import Mount
from mqslam.core.wording import left_or_right
from mqslam.errors import Remedy

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
        told = f"the radar sits {_describe_pose(mount.pose)} ({mount.source})"
        contrary = None if estimate is None else _find_contrary(mount, estimate, limits)
        source, unknown = "given" if mount.given else "recording", np.full(3, np.nan)
        return MountUse(mount.pose, unknown, source, (told,), None if contrary is None else f"{told}, but {contrary}")
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
    told = f"odometry says that the radar sits {_describe_pose(pose, sigmas) if is_off else _describe_origin(sigmas)}"
    if np.isnan(pose[2]):
        return f"{told}; its yaw cannot be told"
    if not is_off:
        return told
    x, y, yaw = pose[0], pose[1], np.degrees(pose[2])
    return f"{told}; {Remedy.GIVE_EXTRINSICS} {x:z.2f},{y:z.2f},{yaw:z.1f} to use it"


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
