"""Whether odometry contradicts the turns that psi found: then it is of another sign, unit or drive, and is not used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.config import OdometryConfig
from mqslam.core.measurement import Measurement, Status
from mqslam.core.trajectory import Trajectory

_SPAN_S: Final = 1.0  # over which turns are compared [s]: long against what single motions err by
_BEYOND: Final = 5.0  # a turn of fewer standard deviations of odometry's yaw rate may be an error of it
_CONTRARY: Final = 0.7  # share of the larger of two turns by which they contradict each other; none is half of the other
_FEWEST: Final = 3  # fewer turns than this may be slip, or an error of psi
_MEANINGS: Final = {
    -1.0: "it turns the other way than the radar: mend its yaw, or set sensor.clockwise: false if the radar is mirrored",
    np.pi / 180.0: "its turns are those of the radar if they are in degrees: convert its yaw rates to rad/s",
    -np.pi / 180.0: "its turns are those of the radar, mirrored, if they are in degrees: convert its yaw rates to rad/s",
}


@dataclass(frozen=True, slots=True)
class OdometryFault:
    """Why odometry is not used.

    Args:
        statement: for the user, in a sentence.
        is_opposite: whether it turns the other way than the radar.
    """

    statement: str
    is_opposite: bool


def find_odometry_fault(
    odometry: Trajectory, start_us: int, measured: Sequence[Measurement], stated: OdometryConfig
) -> OdometryFault | None:
    """Finds whether odometry contradicts the turns of the motions that psi found itself; None where it does not.

    Args:
        odometry: covers the recording.
        start_us: stamp [us] of the recording's time zero.
        measured: motions of the front end.
        stated: the errors that odometry states.
    """
    rows = [(m.t0, m.t1, m.pose[2]) for m in measured if m.status is Status.CONVERGED]
    begins, ends, yaws = np.array(rows, dtype=np.float64).reshape(-1, 3).T
    headings = np.unwrap(odometry.poses[:, 2])
    said = np.subtract(*(np.interp(times, odometry.seconds(start_us), headings) for times in (ends, begins)))
    count = max(1, round(_SPAN_S / float(np.median(ends - begins)))) if len(rows) else 1
    spans = len(rows) // count
    turned, told = (values[: spans * count].reshape(spans, count).sum(axis=1) for values in (yaws, said))
    least = _BEYOND * stated.sigma_yaw_rate * _SPAN_S
    contrary, turns = _count_contrary(turned, told, least)
    if turns < _FEWEST or 2 * contrary <= turns:
        return None
    meant = "they have little in common, as if it were of another drive, another clock or quaternions in another order"
    opposite = False
    for factor, meaning in _MEANINGS.items():
        off, seen = _count_contrary(turned, factor * told, least)
        if seen >= _FEWEST and 2 * off <= seen:
            meant, opposite = meaning, factor < 0.0
            break
    where = f"in {contrary} of the {turns} seconds in which one of the two turns"
    return OdometryFault(f"the odometry is not used: it contradicts the radar {where}; {meant}", opposite)


def _count_contrary(turned: NDArray[np.float64], told: NDArray[np.float64], least: float) -> tuple[int, int]:
    """Returns how many turns of the radar (N,) [rad] and of odometry contradict each other, of how many that are turns."""
    larger = np.maximum(np.abs(turned), np.abs(told))
    contrary = np.abs(turned - told) > _CONTRARY * larger
    return int(np.count_nonzero(contrary & (larger > least))), int(np.count_nonzero(larger > least))
