"""Checks the turns and the speed of a trajectory against odometry.

Wheels slip and odometry drifts, so only gross contradictions count.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.gyroscope_check import pick_stamps
from mqslam.auditing.verdict import Cause, Finding, VerdictStatus
from mqslam.backend.sensors.odometry import LEAST_SPEED, find_odometry_fault
from mqslam.config import OdometryConfig
from mqslam.core import se2
from mqslam.core.measurement import Measurement
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory

_SPAN_US: Final = 1_000_000  # time over which speeds are compared [us], since single motions err too much
_FEWEST: Final = 5  # fewest pairs of poses whose speeds show a scale
# A speed that differs from odometry's by a larger share shows a wrong scale. Worn tyres and slip change it by a few percent.
_WRONG_SCALE: Final = 0.1
_UNITS: Final = {"km/h": 1.0 / 3.6, "miles per hour": 0.44704, "mm/s": 1e-3, "cm/s": 1e-2}  # [m/s]
_SAME_UNIT: Final = 0.1  # a ratio this near to a unit, by share, shows the unit: scales of wheels or bins may be off, too


def check_odometry(odometry: Trajectory, scans: Scans, trajectory: Trajectory, stated: OdometryConfig) -> list[Finding]:
    """Compares odometry with a trajectory; returns a `warn` per contradiction, or one finding that passes if there is none.

    If odometry covers too little of the trajectory, the only finding is one that could not judge.

    Args:
        odometry: poses of the sensor or of the vehicle, since only turns and speeds are compared.
        scans: scans of the recording.
        trajectory: poses of the sensor.
        stated: settings of odometry, with its errors.
    """
    stamps = pick_stamps(scans.stamps_us, trajectory.stamps_us)
    stamps = stamps[(odometry.stamps_us[0] <= stamps) & (stamps <= odometry.stamps_us[-1])]
    if len(stamps) < 2:
        return [Finding(VerdictStatus.PASS, "the odometry covers too little of the trajectory to check it", judged=False)]
    own, given = (Trajectory(stamps, track.at(stamps)) for track in (trajectory, odometry))
    times, steps = own.seconds(scans.start_us), se2.wrapped_between(own.poses[:-1], own.poses[1:])
    moves = [Measurement(t0, t1, step, np.eye(3)) for (t0, t1), step in zip(pairwise(times), steps, strict=True)]
    findings = []
    fault = find_odometry_fault(given, scans.start_us, moves, stated)
    if fault is not None:
        way = "the other way than" if fault.is_opposite else "differently from"
        reason = f"the recording's odometry turns {way} the trajectory {fault.where}"
        if not fault.is_opposite:
            reason += ", as if it belonged to another drive or had another clock"
        cause = Cause.MIRROR if fault.is_opposite else Cause.SENSOR
        findings.append(Finding(VerdictStatus.WARN, reason, cause=cause, explanation=reason))
    ratio = measure_speed_ratio(own, given)
    if ratio is not None and is_wrong_scale(ratio):
        fast = f"the trajectory is {ratio:.3g} times as fast as the recording's odometry"
        reason = f"{fast}: the scale of odometry{name_unit(ratio)}, or the scale of the trajectory is wrong"
        findings.append(Finding(VerdictStatus.WARN, reason, cause=Cause.SCALE, explanation=reason))
    return findings or [Finding(VerdictStatus.PASS, "the recording's odometry does not contradict the trajectory")]


def measure_speed_ratio(own: Trajectory, given: Trajectory) -> float | None:
    """Returns the median speed of a trajectory divided by the median speed of odometry at the same stamps.

    Args:
        own: the trajectory.
        given: odometry at the same stamps.

    Returns:
        the ratio, from all pairs of poses one second apart between which the trajectory or odometry moves; None for fewer
            than `_FEWEST` such pairs, or if a median speed is zero.
    """
    ends = np.searchsorted(own.stamps_us, own.stamps_us + _SPAN_US)
    begins = np.flatnonzero(ends < len(own.stamps_us))
    speeds = [_find_speeds(track, begins, ends[begins]) for track in (own, given)]
    fast = np.maximum(*speeds) > LEAST_SPEED
    if np.count_nonzero(fast) < _FEWEST:
        return None
    slow, quick = (float(np.median(speed[fast])) for speed in speeds)
    return slow / quick if min(slow, quick) > 0.0 else None


def _find_speeds(track: Trajectory, begins: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.float64]:
    """Returns the mean speeds (N,) [m/s] along straight lines between poses with the indices `begins` and `ends` (N,)."""
    moved = track.poses[ends, :2] - track.poses[begins, :2]
    return np.asarray(np.hypot(moved[:, 0], moved[:, 1]) / ((track.stamps_us[ends] - track.stamps_us[begins]) * 1e-6))


def is_wrong_scale(ratio: float) -> bool:
    """Returns whether a ratio of two scales differs from 1 by more than the factor 1 + `_WRONG_SCALE`."""
    return not 1.0 / (1.0 + _WRONG_SCALE) <= ratio <= 1.0 + _WRONG_SCALE


def name_unit(ratio: float) -> str:
    """Returns ", as if its speeds were in" and the unit of odometry that explains a ratio of speeds, or an empty text."""
    units = (unit for unit, size in _UNITS.items() if abs(ratio / size - 1.0) < _SAME_UNIT)
    return next((f", as if its speeds were in {unit}" for unit in units), "")
