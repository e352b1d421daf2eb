"""Checks against motion: psi's own under other assumptions, and odometry's over the same stretches.

The mirror image of a recording moves as the mirror image of its motion and makes the mirror image of its map, which is as
crisp: psi cannot tell left from right, only odometry can. What psi can tell is whether the azimuths of a polar scan came in
the order they are stored in, because in the other order they are corrected for motion the wrong way.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wilcoxon

from mqslam.check.finding import CheckFinding, CheckVerdict
from mqslam.check.following import FEWEST_STEPS, FollowedStretches, Steps
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory

# Speed [m/s] above which the length of a range bin shows.
LEAST_SPEED = 1.0
# Share of the variance of the radar's yaw rate that odometry must explain to tell a shift of stamps.
_EXPLAINED = 0.9

# psi's preference for one order of the azimuths counts if it would come about by chance with a smaller probability than
# this.
_ORDER_CHANCE = 5e-3
# Least logarithm of the ratio of psi in the two orders that counts. Simulated drives too slow to tell the order show up to
# 0.010.
_ORDER_GAIN = 0.02
# Yaw rate [rad/s], root mean square, below which left and right cannot be told apart.
_LEAST_TURN = 0.03
# Least standard deviation of a measured yaw rate [rad/s].
_YAW_RATE_FLOOR = 0.004
# Largest shift of stamps that is tried [turns].
_LARGEST_SHIFT = 1.5
# A shift of stamps is only judged if three standard deviations of it are at most this [turns].
_SHIFT_ERROR = 0.25
# Smallest shift of stamps that is suspicious [turns].
_SHIFT_OK = 0.5

# A direction of rotation is right if the mean squared yaw rate error of the other one is this many times as large.
_MIRRORED = 4.0
# Number of shifts of stamps that are tried, from earliest to latest.
_SHIFTS = 61
# Relative difference between the radar's speed and odometry's that is suspicious.
_WRONG_SCALE = 0.05

_LEAST_SLOPE = 1e-9  # numerical [rad/s^2]: keeps the error of a shift finite where the yaw rate does not change
_LEAST_RATIO = 0.1  # below this ratio of speeds the two have little in common, and no length of a range bin would fit


def check_order(followed: FollowedStretches) -> CheckFinding:
    """Checks whether psi prefers the azimuths of the polar scans in the order they are stored in.

    Args:
        followed: stretches of the recording as psi follows them.
    """
    name = "order of azimuths"
    usable = (followed.psi > 0.0) & (followed.psi_backward > 0.0)  # NaN where no motion was found
    gain = np.log(followed.psi_backward[usable] / followed.psi[usable])
    if len(gain) < FEWEST_STEPS:
        return CheckFinding(name, CheckVerdict.UNTOLD, followed.shortage)
    middle = float(np.median(gain))
    chance = float(wilcoxon(gain).pvalue) if gain.any() else 1.0  # a test by ranks, since turns gain many times as much
    psi, backward = float(followed.psi[usable].mean()), float(followed.psi_backward[usable].mean())
    numbers = {"psi": psi, "psi_backward": backward, "log_ratio": middle, "chance": chance}
    both = f"psi per point is {psi:.3f} as recorded and {backward:.3f} with every turn taken backward"
    if abs(middle) < _ORDER_GAIN or chance > _ORDER_CHANCE:
        return CheckFinding(
            name,
            CheckVerdict.UNTOLD,
            f"{both}, which is about the same; a faster drive or one with turns would tell",
            numbers,
        )
    if middle > 0.0:
        return CheckFinding(name, CheckVerdict.OK, both, numbers)
    remedy = "azimuths seem to be stored against the direction of rotation: store them in the order of measurement"
    return CheckFinding(name, CheckVerdict.SUSPICIOUS, f"{both}; {remedy}", numbers)


def check_mirror(recording: Recording, followed: FollowedStretches, odometry: Trajectory | None) -> CheckFinding:
    """Checks whether the radar turns left where odometry does.

    Args:
        recording: the recording.
        followed: its stretches as psi follows them.
        odometry: of the same clock, or None.
    """
    name = "direction of rotation"
    if odometry is None or len(followed.steps) < FEWEST_STEPS:
        reason = "psi is the same for a recording and its mirror image"
        return CheckFinding(name, CheckVerdict.UNTOLD, _explain_untold(followed, odometry, reason))
    measured, _, given = _yaw_rates(recording, followed.steps, odometry)
    same, opposite = (float(np.min(np.mean((measured - sign * given) ** 2, axis=1))) for sign in (1.0, -1.0))
    numbers = {"rms_as_assumed_rad_s": same**0.5, "rms_mirrored_rad_s": opposite**0.5}
    turning = float(np.sqrt(np.mean(followed.steps.of(odometry)[:, 2] ** 2)))
    ratio = opposite / max(same, _YAW_RATE_FLOOR**2)
    if turning < _LEAST_TURN or 1.0 / _MIRRORED < ratio < _MIRRORED:
        return CheckFinding(
            name,
            CheckVerdict.UNTOLD,
            f"odometry turns by {turning:.3f} rad/s, too little to tell or unlike the radar",
            numbers,
        )
    both = f"yaw rates differ from odometry's by {same**0.5:.3f} rad/s, mirrored by {opposite**0.5:.3f} rad/s"
    if ratio > 1.0:
        return CheckFinding(name, CheckVerdict.OK, both, numbers)
    remedy = "the radar seems to turn the other way round: see sensor.clockwise, or odometry's sign of yaw"
    return CheckFinding(name, CheckVerdict.SUSPICIOUS, f"{both}; {remedy}", numbers)


def check_stamp(recording: Recording, followed: FollowedStretches, odometry: Trajectory | None) -> CheckFinding:
    """Checks whether odometry's yaw rate fits the radar's best at the stamps as they are.

    Args:
        recording: the recording.
        followed: its stretches as psi follows them.
        odometry: of the same clock, or None.
    """
    name = "stamp convention"
    if odometry is None or len(followed.steps) < FEWEST_STEPS:
        reason = "only a motion measured by another clock shows a shift"
        return CheckFinding(name, CheckVerdict.UNTOLD, _explain_untold(followed, odometry, reason))
    measured, shifts, given = _yaw_rates(recording, followed.steps, odometry)
    given *= 1.0 if np.sum(given @ measured) >= 0.0 else -1.0  # another check looks for a mirrored recording
    rest = given - measured
    rest -= rest.mean(axis=1, keepdims=True)  # the gyro's bias
    rms = np.sqrt(np.mean(rest**2, axis=1))
    best = int(np.argmin(rms))
    slope = float(np.std(np.gradient(given, shifts * 1e-6, axis=0)[best]))  # yaw rate per shift [rad/s^2]
    shift = shifts[best] * 1e-6
    error = max(float(rms[best]), _YAW_RATE_FLOOR) / max(slope, _LEAST_SLOPE) / np.sqrt(len(measured))
    explained = 1.0 - float(rms[best]) ** 2 / max(float(np.var(measured)), _YAW_RATE_FLOOR**2)
    numbers = {"shift_s": shift, "shift_error_s": error, "explained": explained}
    unsure = 3.0 * error > _SHIFT_ERROR * recording.revolution_s or best in (0, len(shifts) - 1)
    if explained < _EXPLAINED or unsure:
        return CheckFinding(
            name, CheckVerdict.UNTOLD, "odometry's yaw rate changes too little, or differs from the radar's", numbers
        )
    fits = f"odometry's yaw rate fits best {abs(shift):.2f} s {'later' if shift > 0.0 else 'earlier'}"
    if abs(shift) < _SHIFT_OK * recording.revolution_s:
        allowed = f"within {_SHIFT_OK:g} of a turn of {recording.revolution_s:.2f} s"
        return CheckFinding(name, CheckVerdict.OK, f"{fits}, {allowed}", numbers)
    meant = "the start of the turn, not the end" if shift > 0.0 else "the end of the turn, not the start"
    remedy = f"stamps seem to mean {meant} (sensor.stamp), or the clocks differ"
    return CheckFinding(name, CheckVerdict.SUSPICIOUS, f"{fits}; {remedy}", numbers)


def check_scale(recording: Recording, followed: FollowedStretches, odometry: Trajectory | None) -> CheckFinding:
    """Checks whether the radar's speed is odometry's, which a wrong length of a range bin would change.

    Args:
        recording: the recording.
        followed: its stretches as psi follows them.
        odometry: of the same clock, or None.
    """
    name = "range resolution"
    if odometry is None or len(followed.steps) < FEWEST_STEPS:
        return CheckFinding(
            name,
            CheckVerdict.UNTOLD,
            _explain_untold(followed, odometry, "psi is the same for a map and a scaled copy of it"),
        )
    measured, given = followed.steps.twists[:, 0], followed.steps.of(odometry)[:, 0]
    fast = np.abs(given) > LEAST_SPEED
    if np.count_nonzero(fast) < FEWEST_STEPS:
        return CheckFinding(name, CheckVerdict.UNTOLD, f"odometry is hardly ever faster than {LEAST_SPEED:g} m/s")
    ratio = float(np.sum(measured[fast] * given[fast]) / np.sum(given[fast] ** 2))
    numbers = {"speed_ratio": ratio, "range_resolution_m": recording.range_resolution}
    speeds = f"the radar's speed is {ratio:.3f} times odometry's"
    if abs(ratio - 1.0) < _WRONG_SCALE:
        return CheckFinding(name, CheckVerdict.OK, f"{speeds} with bins of {recording.range_resolution:.4g} m", numbers)
    resolution = recording.range_resolution / ratio if ratio > _LEAST_RATIO else None
    fitting = "they have little in common" if resolution is None else f"bins of {resolution:.4g} m would fit"
    advice = "state the right length of a range bin, unless odometry's scale is off"
    remedy = f"with bins of {recording.range_resolution:.4g} m; {fitting}: {advice}"
    return CheckFinding(name, CheckVerdict.SUSPICIOUS, f"{speeds} {remedy}", numbers)


def _explain_untold(followed: FollowedStretches, odometry: Trajectory | None, reason: str) -> str:
    """Returns why a check against odometry cannot be made: there is none, or too little was followed."""
    return f"no odometry: {reason}" if odometry is None else followed.shortage


def _yaw_rates(
    recording: Recording, steps: Steps, odometry: Trajectory
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Returns yaw rates (S,) of the radar, the shifts (K,) [us] that are tried, and odometry's yaw rates (K, S) at them."""
    turns = np.linspace(-_LARGEST_SHIFT, _LARGEST_SHIFT, _SHIFTS)
    shifts = np.round(turns * recording.revolution_s * 1e6).astype(np.int64)
    return steps.twists[:, 2], shifts, np.array([steps.of(odometry, shift)[:, 2] for shift in shifts.tolist()])
