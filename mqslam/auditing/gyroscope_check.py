"""Checks the turns and the clock of a trajectory against a gyroscope."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.verdict import Cause, Finding, VerdictStatus
from mqslam.backend.sensors.calibration import FEWEST_MOTIONS, SCALE_TOLERANCE, TOLD_SIGMAS
from mqslam.backend.sensors.gyroscope import (
    DELAY_TOLERANCE_S,
    LONGEST_DELAY_S,
    Rotation,
    Turns,
    calibrate,
    find_start,
)
from mqslam.core.scans import Scans
from mqslam.core.sensors import Gyroscope, Turning
from mqslam.core.statistics import SIGMAS_PER_DEVIATION
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import describe_times, left_or_right

# Error of the scale that data sheets of cheap gyroscopes allow. An audit does not call a smaller error a fault.
_LIKELY_SCALE = 0.03

# A turn over a few scans that the gyroscope does not show is tolerated up to this angle [rad]: half a degree.
_KINK_RAD: Final = 0.0087
# A difference between the turns of the trajectory and of the gyroscope is a contradiction only if it is more than this many
# times the usual difference over the same number of steps, since a gyroscope's bias wanders.
_KINK_SIGMAS: Final = 8.0
# Numbers of steps over which turns are added up. A difference that lasts longer may be the bias of the gyroscope.
_KINK_STEPS: Final = (1, 4, 16)

# The gyroscope surely shows a turn if, within the time _TURN_S [s], the turn exceeds the angle _TURN_RAD [rad] and
# _TURN_SIGMAS standard deviations of the noise, and no bias up to _LARGEST_BIAS [rad/s] explains it. No slope or bump tilts
# a vehicle by such an angle.
_TURN_S: Final = 4.0
_TURN_RAD: Final = 0.175
_TURN_SIGMAS: Final = 8.0
_LARGEST_BIAS: Final = 0.05
_MISSED: Final = 0.5  # a trajectory that nowhere turns by this share of such a turn has missed the turn

_SPARSE: Final = 0.7  # with fewer poses per scan than this (1.5 revolutions between poses), a trajectory is interpolated
_LEAST_VARIANCE: Final = 1e-12  # numerical: variance [rad^2] of the turns of a trajectory that agrees exactly


@dataclass(frozen=True, slots=True)
class GyroscopeCheck:
    """The result of comparing a gyroscope with a trajectory.

    Args:
        source: where the gyroscope's readings come from.
        statement: whether the gyroscope and the trajectory agree, in words.
        agrees: whether the gyroscope and the trajectory agree; None where that is not known.
        rotation: calibration that converts the gyroscope's readings to the trajectory's turns; None without a comparison.
        differ_rad: robust standard deviation of the difference that remains in the turn over a scan [rad]; None without a
            comparison.
    """

    source: str
    statement: str
    agrees: bool | None
    rotation: Rotation | None = None
    differ_rad: float | None = None


def check_gyroscope(gyroscope: Gyroscope, scans: Scans, trajectory: Trajectory) -> GyroscopeCheck:
    """Compares a gyroscope with the turns of a trajectory from scan to scan.

    A trajectory does not state the errors of its turns. The gyroscope is therefore calibrated on the turns, and the
    differences that remain are taken as the errors of the turns.

    Args:
        gyroscope: readings of the gyroscope.
        scans: scans of the recording.
        trajectory: poses of the sensor.
    """
    source = gyroscope.source
    inside = pick_stamps(scans.stamps_us, trajectory.stamps_us)
    if len(inside) <= FEWEST_MOTIONS:
        needed = f"a check by the gyroscope ({source}) needs {FEWEST_MOTIONS + 1} scans within the trajectory"
        return GyroscopeCheck(source, f"{needed}, and there are {len(inside)}", None)
    times = np.asarray((inside - scans.start_us) * 1e-6, dtype=np.float64)
    yaws = np.diff(np.unwrap(trajectory.at(inside)[:, 2]))
    variances = np.full(len(yaws), np.median(np.abs(yaws)) ** 2 + _LEAST_VARIANCE)
    turns = Turns(times[:-1], times[1:], yaws, variances, np.ones(len(yaws), dtype=np.bool_), 0.0)
    start = find_start(gyroscope, scans.start_us, turns)
    if start is None or not start.is_convincing():
        missed = _find_missed_turn(gyroscope, scans.start_us, times, yaws)
        if missed:
            return GyroscopeCheck(source, f"the gyroscope ({source}) contradicts the trajectory: {missed}", False)
        turned = float(np.sum(np.abs(yaws)))
        what = f"it shows no turn of the trajectory, which turns by {np.degrees(turned):.0f} deg in all"
        return GyroscopeCheck(source, f"the gyroscope ({source}) cannot be compared with the trajectory: {what}", None)
    found = calibrate(gyroscope, start, turns)
    spread = SIGMAS_PER_DEVIATION * float(np.nanmedian(np.abs(found.residuals))) if found.residuals.size else np.nan
    turns = turns._replace(variances=np.full(len(yaws), spread**2 + _LEAST_VARIANCE))
    found = calibrate(gyroscope, start, turns)
    faults = _list_faults(found.rotation, own_clock=gyroscope.own_clock)
    faults += _find_kink(times, found.residuals)
    if not faults and spread > _KINK_RAD:
        what = f"their turns usually differ by {np.rad2deg(spread):.2g} deg per scan, which hides any smaller fault"
        told = f"the gyroscope ({source}) cannot be compared with the trajectory: {what}"
        return GyroscopeCheck(source, told, None, found.rotation, spread)
    remark = _describe_scale(found.rotation)
    agreed = (
        f"agrees with the trajectory step by step, within {np.rad2deg(spread):.2g} deg; "
        f"{_describe_bias(found.rotation)}{remark}"
    )
    outcome = f"contradicts the trajectory: {'; '.join(faults)}" if faults else agreed
    return GyroscopeCheck(source, f"the gyroscope ({source}) {outcome}", not faults, found.rotation, spread)


def judge_gyroscope(check: GyroscopeCheck) -> Finding:
    """Converts the comparison of a gyroscope with a trajectory to a finding."""
    if check.agrees is None:
        return Finding(VerdictStatus.PASS, check.statement, judged=False)
    if check.agrees:
        return Finding(VerdictStatus.PASS, check.statement)
    mirrored = check.rotation is not None and check.rotation.sign < 0.0
    cause = Cause.MIRROR if mirrored else Cause.SENSOR
    return Finding(VerdictStatus.WARN, check.statement, cause=cause, explanation=check.statement)


def pick_stamps(scans_us: NDArray[np.int64], poses_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns the stamps (K,) [us] between which turns are compared, in the time that scans and poses share.

    The result holds the stamps of the scans, or the stamps of the poses if there are fewer than `_SPARSE` poses per scan.
    Between sparse poses a trajectory is interpolated, so the turns of the sensor there are not known.

    Args:
        scans_us: stamps of the scans [us], increasing.
        poses_us: stamps of the trajectory's poses [us], increasing.
    """
    first, last = max(scans_us[0], poses_us[0]), min(scans_us[-1], poses_us[-1])
    scans, poses = (np.asarray(us[(first <= us) & (us <= last)], dtype=np.int64) for us in (scans_us, poses_us))
    return poses if len(poses) < _SPARSE * len(scans) else scans


def _list_faults(rotation: Rotation, *, own_clock: bool) -> list[str]:
    """Returns in words each fault by which a gyroscope contradicts a trajectory: direction, scale or delay of the turns.

    Args:
        rotation: calibration that converts the gyroscope's readings to the trajectory's turns.
        own_clock: whether the gyroscope has a clock of its own, so that a delay is no fault.
    """
    faults = []
    if rotation.sign < 0.0:
        faults.append("it turns the other way; either it is mounted upside down, or the trajectory is mirrored")
    off, late_s = rotation.scale - 1.0, -rotation.delay_s
    if abs(off) > _LIKELY_SCALE + TOLD_SIGMAS * rotation.scale_sigma:
        faults.append(_compare_turns(off))
    if not own_clock and abs(late_s) > max(TOLD_SIGMAS * rotation.delay_sigma_s, DELAY_TOLERANCE_S):
        faults.append(
            f"the trajectory's stamps are {abs(late_s):.2f} s {'later' if late_s > 0.0 else 'earlier'} than the gyroscope's"
        )
    return faults


def _find_kink(times: NDArray[np.float64], residuals: NDArray[np.float64]) -> list[str]:
    """Returns one sentence on the few steps at which a trajectory contradicts the gyroscope the most; [] if all agree.

    A step is the motion from one time to the next. Each number of steps in `_KINK_STEPS` is tried.

    Args:
        times: (N + 1,) times between which the turns are compared [s].
        residuals: (N,) turn of the trajectory to the left minus turn of the gyroscope in each step [rad]; NaN where unknown.
    """
    angles = np.r_[0.0, np.cumsum(np.nan_to_num(residuals))]
    kinks = []
    for steps in _KINK_STEPS:
        off = angles[steps:] - angles[:-steps]
        if not len(off):
            break
        usual = SIGMAS_PER_DEVIATION * float(np.median(np.abs(off)))
        worst = int(np.argmax(np.abs(off)))
        if abs(off[worst]) > max(_KINK_RAD, _KINK_SIGMAS * usual):
            kinks.append((abs(off[worst]) / (usual + _KINK_RAD), float(off[worst]), times[worst], times[worst + steps]))
    if not kinks:
        return []
    _, turn, begin, end = max(kinks)
    side = left_or_right(turn)
    return [f"{describe_times(begin, end)} the trajectory turns {np.degrees(abs(turn)):.1f} deg farther to the {side}"]


def _find_missed_turn(gyroscope: Gyroscope, start_us: int, times: NDArray[np.float64], yaws: NDArray[np.float64]) -> str:
    """Returns in words the largest turn by the gyroscope that the trajectory nowhere makes; an empty text if none is missed.

    Turns near the ends of the trajectory do not count, since the clocks of gyroscope and trajectory may differ.

    Args:
        gyroscope: readings of the gyroscope.
        start_us: stamp [us] of the recording's time zero.
        times: (N + 1,) times between which the turns are compared [s].
        yaws: (N,) turns of the trajectory [rad].
    """
    if len(gyroscope) < 2:
        return ""
    steps = min(max(round(_TURN_S / float(np.median(np.diff(times)))), 1), len(yaws))
    inside = (times[:-steps] >= times[0] + LONGEST_DELAY_S) & (times[steps:] <= times[-1] - LONGEST_DELAY_S)
    reading_s = 1e-6 * float(np.median(np.diff(gyroscope.stamps_us)))
    angles, missed = np.r_[0.0, np.cumsum(yaws)], (0.0, "")
    most = float(np.max(np.abs(angles[steps:] - angles[:-steps])))
    for axis, name in enumerate("xyz"):
        turned = Turning.integrate(gyroscope, start_us, axis).between(times[:-steps], times[steps:])
        lasted_s = times[steps:] - times[:-steps]
        known = np.isfinite(turned) & inside
        if not known.any():
            continue
        bias = float(np.clip(np.median(turned[known] / lasted_s[known]), -_LARGEST_BIAS, _LARGEST_BIAS))
        off = np.where(known, np.abs(turned - bias * lasted_s), 0.0)
        worst = int(np.argmax(off))
        changes = np.abs(np.diff(gyroscope.rates[:, axis]))
        noise = SIGMAS_PER_DEVIATION * float(np.median(changes)) / np.sqrt(2.0) * np.sqrt(reading_s * lasted_s[worst])
        if off[worst] > max(_TURN_RAD, _TURN_SIGMAS * noise, most / _MISSED, missed[0]):
            turn = f"it turns by {np.degrees(off[worst]):.0f} deg about its {name} axis"
            nowhere = f"the trajectory nowhere turns by more than {np.degrees(most):.1f} deg in as long a time"
            missed = off[worst], f"{turn} {describe_times(times[worst], times[worst + steps])}, but {nowhere}"
    return missed[1]


def _describe_bias(rotation: Rotation) -> str:
    """Returns words on the estimated bias of a gyroscope, which hides a constant drift of the trajectory's yaw."""
    rate = abs(float(np.rad2deg(rotation.bias)))
    return f"it cannot show a steady drift of yaw, since a constant {rate:.2g} deg/s is taken as its bias"


def _describe_scale(rotation: Rotation) -> str:
    """Returns a remark on how much farther a trajectory turns than a gyroscope; "" if tolerated or explained by chance."""
    off = rotation.scale - 1.0
    if abs(off) <= max(TOLD_SIGMAS * rotation.scale_sigma, SCALE_TOLERANCE):
        return ""
    return f"; {_compare_turns(off)}, which the scale of a gyroscope may explain"


def _compare_turns(off: float) -> str:
    """Returns in words that a trajectory turns by the share `off` farther (if negative, less) than a gyroscope."""
    return f"the trajectory turns {abs(off):.1%} {'farther' if off > 0.0 else 'less'} than the gyroscope"
