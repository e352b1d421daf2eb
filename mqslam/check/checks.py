"""Checks a recording against the assumptions under which it was read.

The mirror image of a recording gives a mirrored motion and a mirrored map, which is just as crisp. psi therefore cannot tell
left from right; only odometry can. But psi can tell whether the azimuths of a polar scan were measured in the order in which
they are stored: in the opposite order, motion compensation moves returns the wrong way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wilcoxon

from mqslam.backend.sensors.odometry import LEAST_SPEED
from mqslam.check.stretches import (
    FEWEST_STEPS,
    FollowedStretches,
    Steps,
    Stretch,
    choose_spans,
    follow,
    read_stretches,
    track_scans,
)
from mqslam.config import Config
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.errors import EstimationError
from mqslam.execution.local_engine import HERE
from mqslam.formats.recordings.turns import find_usual_turns
from mqslam.psi.place import Beam
from mqslam.psi.ranging import FEWEST_STRETCHES, RangeErrors, measure_on_stretches
from mqslam.psi.tracking.tracker import Tracker

# Largest tolerated difference between the durations of 90 % of all revolutions of the radar, as a share of a revolution.
_UNSTEADY = 0.1
# Azimuth times that span less than this share of a revolution do not say when each azimuth was measured.
_SPAN_SHARE = 0.8
# Largest tolerated share of a revolution by which a polar scan lasts into the next polar scan.
_LATE_SHARE = 0.05
# A step between azimuths of more than this many usual steps is a hole. A revolution may lack this much of a whole turn.
_HOLE_STEPS = 3.0
# Largest tolerated share of azimuths that are marked as not measured.
_UNMEASURED_SHARE = 0.05
# A polar scan that begins within this share of a revolution after another polar scan begins too soon.
_DOUBLED = 0.5
# Fewest revolutions that show whether the duration of a revolution is steady.
_FEWEST_TURNS = 3

# Share of the variance of the radar's yaw rate that odometry must explain for a shift of stamps to be judged.
_EXPLAINED = 0.9

# psi's preference for one order of the azimuths counts only if its probability by chance is smaller than this.
_ORDER_CHANCE = 5e-3
# psi's preference counts only if the logarithm of the ratio of psi in the two orders is at least this. In simulated drives
# that are too slow to show the order it is at most 0.010.
_ORDER_GAIN = 0.02
# Root mean square yaw rate [rad/s] below which left and right cannot be distinguished.
_LEAST_TURN = 0.03
# Smallest standard deviation that is assumed for a measured yaw rate [rad/s].
_YAW_RATE_FLOOR = 0.004
# Largest shift of stamps that is tried [revolutions].
_LARGEST_SHIFT = 1.5
# A shift of stamps is only judged if three standard deviations of it are at most this [revolutions].
_SHIFT_ERROR = 0.25
# Smallest shift of stamps that is suspicious [revolutions].
_SHIFT_OK = 0.5

# A direction of rotation is right if the mean squared yaw rate error of the opposite direction is this many times as large.
_MIRRORED = 4.0
# Number of shifts of stamps that are tried, from earliest to latest.
_SHIFTS = 61
# Relative difference between the radar's speed and odometry's that is suspicious.
_WRONG_SCALE = 0.05

_SPREAD = 12  # number of stretches of the recording on which errors of the ranges are measured

_LEAST_SLOPE = 1e-9  # numerical [rad/s^2]: keeps the error of a shift finite where the yaw rate does not change
_LEAST_RATIO = 0.1  # at a lower ratio, the two speeds have little in common, and no length of the range bins explains it


class CheckVerdict(StrEnum):
    """The result of a check: whether the recording agrees with the assumption under which it was read."""

    OK = "ok"
    SUSPICIOUS = "suspicious"
    UNTOLD = "cannot be told"


@dataclass(frozen=True, slots=True)
class CheckFinding:
    """The outcome of one check.

    Args:
        name: name of the check.
        verdict: whether the recording agrees with the assumption under which it was read.
        text: the reason for the verdict, and what the user can do.
        numbers: the values that the verdict rests on, by name. A value with a unit has it at the end of its name, but values
            whose names begin with `doppler_` are in seconds.
    """

    name: str
    verdict: CheckVerdict
    text: str
    numbers: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Check:
    """The outcome of all checks of a recording.

    Args:
        findings: the outcome of each check.
        notes: sentences for the user on how the recording and its odometry were read.
        read: number of polar scans that were read.
        scans: number of polar scans in the recording.
    """

    findings: tuple[CheckFinding, ...]
    notes: tuple[str, ...]
    read: int
    scans: int

    @property
    def suspicious(self) -> bool:
        """Whether any check has the verdict `suspicious`."""
        return any(finding.verdict is CheckVerdict.SUSPICIOUS for finding in self.findings)

    @property
    def warning(self) -> str | None:
        """A warning to the user if more than half of the checks cannot be decided; else None."""
        untold = sum(finding.verdict is CheckVerdict.UNTOLD for finding in self.findings)
        if 2 * untold <= len(self.findings):
            return None
        missed = f"{untold} of {len(self.findings)} checks cannot be decided, so that most mistakes would go unnoticed here"
        return f"{missed}; give odometry or a longer drive with turns to decide more of them"


Outcome = tuple[CheckVerdict, str, dict[str, float]]  # a finding without its name


def check_recording(
    recording: Recording,
    odometry: Trajectory | None,
    settings: Config,
    beam: Beam,
    notes: Sequence[str],
    progress: Callable[[int, int], object],
) -> Check:
    """Checks whether a recording contradicts the assumptions under which it was read, without ground truth.

    Args:
        recording: the recording, of which a few short stretches are read.
        odometry: odometry on the same clock, or None.
        settings: all settings.
        beam: the sensor's measurement errors.
        notes: sentences for the user on how the recording and its odometry were read.
        progress: called with the number of polar scans read so far, and the number of polar scans to read. Both numbers
            start again for the check of the ranges, which reads other stretches.
    """
    stretches = read_stretches(recording, odometry, settings.detector, progress)
    followed = follow(recording, stretches, settings, beam)
    findings = [check_stamps(recording, stretches), check_azimuths(stretches), check_order(followed)]
    for name, (check, unseen) in _AGAINST_ODOMETRY.items():
        if odometry is not None and len(followed.steps) >= FEWEST_STEPS:
            findings.append(CheckFinding(name, *check(recording, followed.steps, odometry)))
        else:
            text = f"no odometry: {unseen}" if odometry is None else followed.shortage
            findings.append(CheckFinding(name, CheckVerdict.UNTOLD, text))
    spread = read_spread(recording, settings, progress)
    findings += check_ranges(recording, spread, settings, beam)
    read = len({scan.t0 for stretch in (*stretches, *spread) for scan in stretch.scans})  # both may read the same scans
    return Check(tuple(findings), tuple(notes), read, len(recording))


def read_spread(recording: Recording, settings: Config, progress: Callable[[int, int], object]) -> list[Stretch]:
    """Reads the stretches on which errors of the ranges are measured; returns [] if too few stretches are without gaps."""
    if len(choose_spans(recording, None, _SPREAD)) < FEWEST_STRETCHES:
        return []
    return read_stretches(recording, None, settings.detector, progress, _SPREAD)


def _measure_ranges(stretches: Sequence[Stretch], settings: Config, beam: Beam) -> RangeErrors | None:
    """Tracks stretches by psi and measures the errors of the ranges on them; None if too few stretches show these errors."""
    tracked = []
    for stretch in stretches:
        tracker = Tracker(settings.tracker, settings.estimator, beam, stretch.scans.revolution_s)
        with suppress(EstimationError):
            tracked.append((stretch.scans, np.array([scan.pose for scan in track_scans(stretch.scans, tracker)])))
    return measure_on_stretches(tracked, settings.estimator, beam, HERE)


def check_ranges(recording: Recording, stretches: Sequence[Stretch], settings: Config, beam: Beam) -> list[CheckFinding]:
    """Checks whether psi shows another range offset than the offset in use; returns [] if too few stretches show an offset.

    Args:
        recording: the recording.
        stretches: stretches of the recording, spread over it.
        settings: all settings.
        beam: the sensor's measurement errors.
    """
    found = _measure_ranges(stretches, settings, beam)
    if found is not None:  # with the right Doppler shift, tracks are better and show the offset better
        found = _measure_ranges(stretches, settings, beam._replace(doppler_beta=found.beta)) or found
    if found is None:
        return []
    sigma, sigma_beta = found.sigmas.tolist()
    used = recording.range_offset
    numbers = {
        "range_offset_m": used + found.offset,
        "sigma_m": sigma,
        "doppler_beta": found.beta,
        "doppler_sigma": sigma_beta,
    }
    verdict = CheckVerdict.SUSPICIOUS if found.contradicts else CheckVerdict.OK
    return [CheckFinding("ranges", verdict, "; ".join(found.describe(used)), numbers)]


def check_stamps(recording: Recording, stretches: Sequence[Stretch]) -> CheckFinding:
    """Checks the times of polar scans, and whether any is missing, repeated or unreadable; adds faults found by the reader.

    Args:
        recording: the recording.
        stretches: stretches of the recording that were read.
    """
    turn_s = recording.revolution_s
    steps = np.diff(recording.stamps_us)
    durations = steps[recording.ends_us[:-1] == recording.stamps_us[1:]] * 1e-6
    close = int(np.count_nonzero(steps < _DOUBLED * find_usual_turns(recording.stamps_us)))
    shown = len(durations) >= _FEWEST_TURNS
    unsteady = float(np.ptp(np.percentile(durations, [5.0, 95.0]))) / turn_s if shown else 0.0
    gaps = recording.gaps()
    missing = sum(seconds for _, seconds in gaps)
    turns = [turn for stretch in stretches for turn in stretch.turns]
    counted = {
        f"followed by a gap, {missing:.2f} s in all": len(gaps),
        "that begin too soon after the previous one": close,
        "equal to the previous one, byte by byte": sum(turn.repeated for turn in turns),
        "that last into the next one": sum(turn.late_s > _LATE_SHARE * turn.turn_s for turn in turns),
        "with azimuth times that span less than the turn": sum(turn.span_s < _SPAN_SHARE * turn.turn_s for turn in turns),
    }
    faults = [f"polar scans {text}: {count}" for text, count in counted.items() if count]
    if unsteady > _UNSTEADY:
        faults.append(f"the duration of a turn varies by {unsteady:.0%}")
    unread = [error for stretch in stretches for error in stretch.unread]
    faults += recording.faults
    if unread:
        others = f", and {len(unread) - 1} more" if len(unread) > 1 else ""
        faults.append(f"a polar scan cannot be read: {unread[0]}{others}")
    numbers = {"gaps": len(gaps), "missing_s": missing, "turn_s": turn_s, "unsteady": unsteady}
    if faults:
        return CheckFinding("stamps", CheckVerdict.SUSPICIOUS, "; ".join(faults), numbers)
    steady = f"90 % of which differ by at most {unsteady:.1%}" if shown else "too few to show how steady turns are"
    return CheckFinding(
        "stamps", CheckVerdict.OK, f"{count_of(len(recording), 'turn')} of {turn_s:.4f} s, {steady}, no gaps", numbers
    )


def check_azimuths(stretches: Sequence[Stretch]) -> CheckFinding:
    """Checks whether every polar scan is a whole revolution without holes, and whether its azimuths were measured.

    Args:
        stretches: stretches of the recording that were read.
    """
    turns = [turn for stretch in stretches for turn in stretch.turns]
    if not turns:
        return CheckFinding("azimuths", CheckVerdict.UNTOLD, "no polar scan could be read")
    counts = sorted({turn.azimuths for turn in turns})
    share = sum(turn.unmeasured for turn in turns) / sum(turn.azimuths for turn in turns)
    step = float(np.median([turn.step for turn in turns]))
    off = max(abs(turn.turned - 2.0 * np.pi) for turn in turns)
    widest = max(turn.widest for turn in turns)
    faults = []
    if share > _UNMEASURED_SHARE:
        faults.append(f"{share:.0%} of the azimuths were not measured")
    if widest > _HOLE_STEPS * step:
        faults.append(f"holes of up to {np.rad2deg(widest):.1f} deg between azimuths")
    if off > _HOLE_STEPS * step:
        faults.append(f"polar scans are up to {np.rad2deg(off):.1f} deg off a whole turn")
    numbers = {"fewest": counts[0], "most": counts[-1], "unmeasured": share, "off_turn_rad": off}
    if faults:
        return CheckFinding("azimuths", CheckVerdict.SUSPICIOUS, "; ".join(faults), numbers)
    many = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0]}"
    return CheckFinding("azimuths", CheckVerdict.OK, f"{many} in every turn, {share:.1%} of them not measured", numbers)


def check_order(followed: FollowedStretches) -> CheckFinding:
    """Checks whether psi is lower with the azimuths of the polar scans in the stored order than in the opposite order.

    Args:
        followed: results of tracking the stretches in both orders.
    """
    name = "order of azimuths"
    usable = (followed.psi > 0.0) & (followed.psi_backward > 0.0)  # NaN for a scan without points
    gain = np.log(followed.psi_backward[usable] / followed.psi[usable])
    if len(gain) < FEWEST_STEPS:
        return CheckFinding(name, CheckVerdict.UNTOLD, followed.shortage)
    middle = float(np.median(gain))
    chance = float(wilcoxon(gain).pvalue) if gain.any() else 1.0  # a rank test: scans in bends gain many times as much
    psi, backward = float(followed.psi[usable].mean()), float(followed.psi_backward[usable].mean())
    numbers = {"psi": psi, "psi_backward": backward, "log_ratio": middle, "chance": chance}
    both = f"psi per point is {psi:.3f} as recorded and {backward:.3f} with every turn taken backward"
    if abs(middle) < _ORDER_GAIN or chance > _ORDER_CHANCE:
        return CheckFinding(
            name,
            CheckVerdict.UNTOLD,
            f"{both}, which is about the same; a faster drive or a drive with turns would show the order",
            numbers,
        )
    if middle > 0.0:
        return CheckFinding(name, CheckVerdict.OK, both, numbers)
    remedy = "azimuths seem to be stored against the direction of rotation: store them in the order of measurement"
    return CheckFinding(name, CheckVerdict.SUSPICIOUS, f"{both}; {remedy}", numbers)


def _check_mirror(recording: Recording, steps: Steps, odometry: Trajectory) -> Outcome:
    """Checks whether the radar's yaw rate has the same sign as odometry's yaw rate."""
    measured, _, given = _yaw_rates(recording, steps, odometry)
    same, opposite = (float(np.min(np.mean((measured - sign * given) ** 2, axis=1))) for sign in (1.0, -1.0))
    numbers = {"rms_as_assumed_rad_s": same**0.5, "rms_mirrored_rad_s": opposite**0.5}
    turning = float(np.sqrt(np.mean(steps.of(odometry)[:, 2] ** 2)))
    ratio = opposite / max(same, _YAW_RATE_FLOOR**2)
    if turning < _LEAST_TURN or 1.0 / _MIRRORED < ratio < _MIRRORED:
        text = f"odometry turns at {turning:.3f} rad/s: too slowly, or too unlike the radar, to compare directions"
        return CheckVerdict.UNTOLD, text, numbers
    both = f"yaw rates differ from odometry's by {same**0.5:.3f} rad/s, and if mirrored by {opposite**0.5:.3f} rad/s"
    if ratio > 1.0:
        return CheckVerdict.OK, both, numbers
    remedy = "the radar seems to turn the other way round: change sensor.clockwise, or the sign of odometry's yaw"
    return CheckVerdict.SUSPICIOUS, f"{both}; {remedy}", numbers


def _check_stamp(recording: Recording, steps: Steps, odometry: Trajectory) -> Outcome:
    """Checks whether odometry's yaw rate fits the radar's yaw rate best without a shift of the radar's stamps."""
    measured, shifts, given = _yaw_rates(recording, steps, odometry)
    given *= 1.0 if np.sum(given @ measured) >= 0.0 else -1.0  # another check finds a mirrored recording
    rest = given - measured
    rest -= rest.mean(axis=1, keepdims=True)  # removes the bias of the gyroscope in odometry
    rms = np.sqrt(np.mean(rest**2, axis=1))
    best = int(np.argmin(rms))
    slope = float(np.std(np.gradient(given, shifts * 1e-6, axis=0)[best]))  # yaw rate per shift [rad/s^2]
    shift = shifts[best] * 1e-6
    error = max(float(rms[best]), _YAW_RATE_FLOOR) / max(slope, _LEAST_SLOPE) / np.sqrt(len(measured))
    explained = 1.0 - float(rms[best]) ** 2 / max(float(np.var(measured)), _YAW_RATE_FLOOR**2)
    numbers = {"shift_s": shift, "shift_error_s": error, "explained": explained}
    unsure = 3.0 * error > _SHIFT_ERROR * recording.revolution_s or best in (0, len(shifts) - 1)
    if explained < _EXPLAINED or unsure:
        text = "odometry's yaw rate changes too little, or differs too much from the radar's, to show a shift"
        return CheckVerdict.UNTOLD, text, numbers
    fits = f"odometry's yaw rate fits best {abs(shift):.2f} s {'later' if shift > 0.0 else 'earlier'}"
    if abs(shift) < _SHIFT_OK * recording.revolution_s:
        allowed = f"within {_SHIFT_OK:g} of a turn of {recording.revolution_s:.2f} s"
        return CheckVerdict.OK, f"{fits}, {allowed}", numbers
    meant = "the start of the turn, not the end" if shift > 0.0 else "the end of the turn, not the start"
    remedy = f"stamps seem to mean {meant} (change sensor.stamp), or the clocks differ"
    return CheckVerdict.SUSPICIOUS, f"{fits}; {remedy}", numbers


def _check_scale(recording: Recording, steps: Steps, odometry: Trajectory) -> Outcome:
    """Checks whether the radar's speed, which a wrong length of the range bins changes, equals odometry's speed."""
    measured, given = steps.twists[:, 0], steps.of(odometry)[:, 0]
    fast = np.abs(given) > LEAST_SPEED
    if np.count_nonzero(fast) < FEWEST_STEPS:
        return CheckVerdict.UNTOLD, f"odometry is hardly ever faster than {LEAST_SPEED:g} m/s", {}
    ratio = float(np.sum(measured[fast] * given[fast]) / np.sum(given[fast] ** 2))
    bin_m = recording.range_resolution
    numbers = {"speed_ratio": ratio, "range_resolution_m": bin_m}
    speeds = f"the radar's speed is {ratio:.3f} times odometry's with bins of {bin_m:.4g} m"
    if abs(ratio - 1.0) < _WRONG_SCALE:
        return CheckVerdict.OK, speeds, numbers
    fitting = f"bins of {bin_m / ratio:.4g} m would fit" if ratio > _LEAST_RATIO else "the speeds have little in common"
    remedy = "state the right length of a range bin, unless odometry's scale is off"
    return CheckVerdict.SUSPICIOUS, f"{speeds}; {fitting}: {remedy}", numbers


_AGAINST_ODOMETRY: dict[str, tuple[Callable[[Recording, Steps, Trajectory], Outcome], str]] = {
    "direction of rotation": (_check_mirror, "psi is the same for a recording and its mirror image"),
    "stamp convention": (_check_stamp, "only a motion measured by another clock shows a shift"),
    "range resolution": (_check_scale, "psi is the same for a map and a scaled copy of it"),
}
"""The checks against odometry by name, each with the reason why the check needs odometry."""


def _yaw_rates(
    recording: Recording, steps: Steps, odometry: Trajectory
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Returns yaw rates of the radar (S,) [rad/s], shifts (K,) [us], and odometry's yaw rates (K, S) [rad/s] at each shift.

    Each of the S yaw rates is the mean over a step. A shift is added to the stamps at which the steps begin and end.
    """
    turns = np.linspace(-_LARGEST_SHIFT, _LARGEST_SHIFT, _SHIFTS)
    shifts = np.round(turns * recording.revolution_s * 1e6).astype(np.int64)
    return steps.twists[:, 2], shifts, np.array([steps.of(odometry, shift)[:, 2] for shift in shifts.tolist()])
