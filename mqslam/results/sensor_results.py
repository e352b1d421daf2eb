"""What a run says of the sensors beside the radar, in summary.json."""

from __future__ import annotations

from typing import Any

from mqslam.auditing.gyroscope_check import GyroscopeCheck
from mqslam.backend.sensors.chirps import VelocityUse
from mqslam.backend.sensors.gnss import FixUse
from mqslam.backend.sensors.gyroscope import GyroscopeUse, Rotation
from mqslam.backend.sensors.mount import MountUse
from mqslam.solution import Solution


def summarise_sensors(run: Solution) -> dict[str, Any]:
    """Returns what became of each sensor, and how far it moves the trajectory; None for one that there is not."""
    used = run.sensors
    gyroscope = None if used.gyroscope is None else _summarise_gyroscope(used.gyroscope)
    gnss = None if used.fixes is None else _summarise_fixes(used.fixes, run)
    chirps = None if used.velocities is None else _summarise_velocities(used.velocities)
    found = {"gyroscope": gyroscope, "gnss": gnss, "chirps": chirps}
    for name, numbers in found.items():
        if numbers is not None:
            moved = used.contributions.get(name)
            numbers["moved_m"] = None if moved is None else moved.moved_m
            numbers["turned_rad"] = None if moved is None else moved.turned_rad
            if moved is not None:
                numbers["statements"].append(moved.describe(name))
    return found


def summarise_mount(mount: MountUse) -> dict[str, Any]:
    """Returns where the radar sits on the vehicle; NaN, which JSON has as null, where it is not known."""
    numbers = dict(zip(("x_m", "y_m", "yaw_rad"), mount.pose.tolist(), strict=True))
    numbers |= zip(("sigma_x_m", "sigma_y_m", "sigma_yaw_rad"), mount.sigmas.tolist(), strict=True)
    return {**numbers, "source": mount.source, "statements": list(mount.statements)}


def summarise_check(check: GyroscopeCheck) -> dict[str, Any]:
    """Returns what an audit found of a gyroscope and a trajectory."""
    numbers: dict[str, Any] = {"source": check.source, "agrees": check.agrees, "statement": check.statement}
    numbers["differ_rad"] = check.differ_rad
    return numbers | ({} if check.rotation is None else _list_rotation(check.rotation))


def _summarise_gyroscope(use: GyroscopeUse) -> dict[str, Any]:
    """Returns what was found of a gyroscope."""
    numbers: dict[str, Any] = {"source": use.source, "used": use.edges is not None, "statements": list(use.statements)}
    numbers["factors"] = 0 if use.edges is None else use.edges.count
    return numbers | ({} if use.rotation is None else _list_rotation(use.rotation))


def _list_rotation(rotation: Rotation) -> dict[str, Any]:
    """Returns how a gyroscope's readings become turns."""
    return {
        "axis": rotation.axis,
        "upside_down": rotation.sign < 0.0,
        "scale": rotation.scale,
        "sigma_scale": rotation.scale_sigma,
        "late_s": rotation.delay_s,
        "sigma_late_s": rotation.delay_sigma_s,
        "bias_radps": rotation.bias,
        "white_noise": rotation.noise.white,
        "bias_walk": rotation.noise.walk,
    }


def _summarise_fixes(use: FixUse, run: Solution) -> dict[str, Any]:
    """Returns what was found of GNSS fixes."""
    numbers: dict[str, Any] = {"source": use.source, "used": use.edges is not None, "statements": list(use.statements)}
    edges = use.edges
    if edges is None:
        return numbers | {"factors": 0}
    if use.antenna is not None:
        numbers |= zip(("antenna_x_m", "antenna_y_m"), use.antenna.place.tolist(), strict=True)
        numbers |= zip(("sigma_antenna_x_m", "sigma_antenna_y_m"), use.antenna.sigmas.tolist(), strict=True)
    return numbers | {
        "factors": len(edges.scans),
        "rejected": edges.count_rejected(run.values),
        "white_m": edges.noise.white_m,
        "walk_m": edges.noise.walk_m,
    }


def _summarise_velocities(use: VelocityUse) -> dict[str, Any]:
    """Returns what was found of the velocities that chirps measure."""
    numbers: dict[str, Any] = {"source": use.source, "used": use.edges is not None, "statements": list(use.statements)}
    return numbers | {
        "factors": 0 if use.edges is None else len(use.edges),
        "scale": use.scale,
        "sigma_scale": use.sigma_scale,
        "bias_forward_mps": use.bias[0],
        "bias_left_mps": use.bias[1],
    }
