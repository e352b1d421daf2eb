"""Where a sensor sits on a vehicle, as a user states it: metres forward, metres to the left and degrees to the left."""

from __future__ import annotations

import numpy as np

from mqslam.core import se2
from mqslam.errors import ConfigError, Remedy

_LARGEST = np.array([100.0, 100.0, 360.0])  # beyond any vehicle [m, m, degrees]: in other units, or no numbers
_FORM = f"{Remedy.GIVE_EXTRINSICS} as metres forward, metres to the left and degrees to the left"


def parse_extrinsics(text: str) -> tuple[float, float, float]:
    """Parses a text X,Y,YAW.

    Raises:
        ConfigError: the text is not made of three numbers.
    """
    try:
        x, y, yaw = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(f"extrinsics {text}: are not three numbers; {_FORM}, such as 1.2,0,-90") from None
    return x, y, yaw


def read_extrinsics(
    given: tuple[float, float, float] | str | None,
) -> tuple[tuple[float, float, float] | None, se2.Array | None]:
    """Returns extrinsics that are given as three numbers or as a text X,Y,YAW, and the pose (3,) [m, rad] that they are.

    Raises:
        ConfigError: the text is not made of three numbers, or they are beyond any vehicle.
    """
    if given is None:
        return None, None
    stated = parse_extrinsics(given) if isinstance(given, str) else given
    return stated, to_pose(stated)


def name_extrinsics(given: tuple[float, float, float] | str) -> str:
    """Returns extrinsics as a text X,Y,YAW; `auto` and `none` are one already."""
    return given if isinstance(given, str) else ",".join(repr(float(value)) for value in given)


def to_pose(extrinsics: tuple[float, float, float]) -> se2.Array:
    """Returns extrinsics in metres and degrees as a pose (3,) in metres and radians.

    Raises:
        ConfigError: they are not three numbers, or beyond any vehicle or turn.
    """
    pose = np.asarray(extrinsics, dtype=np.float64)
    if pose.shape != (3,) or not np.all(np.abs(pose) <= _LARGEST):
        given = ", ".join(f"{value:g}" for value in pose.ravel())
        raise ConfigError(f"extrinsics of {given} are beyond any vehicle; {_FORM}")
    return np.array([pose[0], pose[1], np.radians(pose[2])])
