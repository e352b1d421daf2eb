"""Checks against motion: psi's own under other assumptions, and what odometry says of the same stretches.

The mirror image of a recording moves as the mirror image of its motion and makes the mirror image of its map, which is as
crisp: psi cannot tell left from right, only odometry can. What psi can tell is whether the azimuths of a revolution came
in the order they are in: swept the other way they are corrected for motion the wrong way.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wilcoxon

from mqslam.check.finding import Finding, Verdict
from mqslam.check.stretches import Stretch
from mqslam.config import EstimatorConfig, TrackerConfig
from mqslam.core import se2
from mqslam.core.measurement import Status
from mqslam.core.recording import Recording
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.core.trajectory import Trajectory
from mqslam.errors import EstimationError
from mqslam.psi.place import Beam
from mqslam.psi.tracking.tracked import Tracked
from mqslam.psi.tracking.tracker import Tracker

_CHANCE = 5e-3  # probability below which a preference of psi's for an order of azimuths is none of chance
_SPREAD_M = 40.0  # keyframes far apart: what a wrong order does shows against what was seen from elsewhere [m]
_LEAST_GAIN = 0.02  # and its least relative size; simulated drives too slow to tell have shown up to 0.010
_MIRRORED = 4.0  # a sign of the yaw rate is right if the other one leaves so many times the squared difference
_LEAST_TURN = 0.03  # yaw rate [rad/s] below which left and right are alike
_LEAST_SPEED = 1.0  # [m/s]
_WRONG_SCALE = 0.05  # relative error of the speed that odometry does not explain
_EXPLAINED = 0.9  # share of the yaw rate's variance that odometry must explain to tell its shift
_RATE_FLOOR = 0.004  # least standard deviation of a yaw rate [rad/s]
_FEWEST = 5  # steps that a comparison with odometry needs, and values of psi that one of orders does


@dataclass(frozen=True, slots=True)
class Steps:
    """Motion from revolution to revolution as psi finds it.

    Args:
        begins_us, ends_us: (S,) int64 [us], when the steps begin and end.
        twists: (S, 3) their mean twists [m/s, m/s, rad/s].
    """

    begins_us: NDArray[np.int64]
    ends_us: NDArray[np.int64]
    twists: se2.Array

    def of(self, track: Trajectory, shift_us: int = 0) -> se2.Array:
        """The mean twists (S, 3) of a trajectory over the same steps, taken later by a shift [us]."""
        return track.mean_twists(self.begins_us + shift_us, self.ends_us + shift_us)


@dataclass(frozen=True, slots=True)
class Followed:
    """Stretches as psi follows them.

    Args:
        steps: motion between revolutions that were found.
        psi: (R,) psi per point of the revolutions.
        psi_backward: (R,) the same with the azimuths of every revolution taken in the opposite order.
        longest: number of scans in the longest stretch.
        needed: number of scans without a gap that tell enough.
    """

    steps: Steps
    psi: NDArray[np.float64]
    psi_backward: NDArray[np.float64]
    longest: int
    needed: int

    @property
    def shortage(self) -> str:
        """Why there is too little to tell from."""
        if self.longest < self.needed:
            return f"it takes {self.needed} revolutions without a gap to tell, and there are no more than {self.longest}"
        return "too few revolutions could be followed"


def follow(
    recording: Recording,
    stretches: Sequence[Stretch],
    tracker: TrackerConfig,
    estimator: EstimatorConfig,
    beam: Beam,
) -> Followed:
    """Track the stretches by psi, as they are and with their azimuths in the opposite order."""
    spread = tracker.model_copy(update={"keyframe_m": _SPREAD_M})

    def tracked(scans: Scans) -> list[Tracked]:
        following = Tracker(spread, estimator, beam, scans.revolution_s)
        first = following.start(scans[: tracker.start_scans])
        return [first, *(following.follow(scan) for scan in scans[1:])]

    edges: list[tuple[float, float]] = []
    twists: list[se2.Array] = []
    forward: list[float] = []
    backward: list[float] = []
    for stretch in stretches:
        if len(stretch.scans) < tracker.start_scans:
            continue
        try:
            found = tracked(stretch.scans)
            other = tracked(replace(stretch.scans, scans=tuple(map(_reversed, stretch.scans))))
        except EstimationError:
            continue
        for a, b in itertools.pairwise(found):
            if a.status is b.status is Status.CONVERGED:
                edges.append((a.t0, b.t0))
                twists.append(se2.log(se2.between(a.pose, b.pose)) / (b.t0 - a.t0))
        for one, two in zip(found[tracker.start_scans - 1 :], other[tracker.start_scans - 1 :], strict=True):
            forward.append(_per_point(one))
            backward.append(_per_point(two))
    stamps = recording.start_us + np.round(np.array(edges).reshape(-1, 2) * 1e6).astype(np.int64)
    steps = Steps(stamps[:, 0], stamps[:, 1], np.array(twists).reshape(-1, 3))
    longest = max((len(stretch.scans) for stretch in stretches), default=0)
    return Followed(steps, np.array(forward), np.array(backward), longest, tracker.start_scans - 1 + _FEWEST)


def check_order(followed: Followed) -> Finding:
    """Whether psi prefers the azimuths of a revolution in the order they are in."""
    name = "order of azimuths"
    usable = (followed.psi > 0.0) & (followed.psi_backward > 0.0)  # NaN where nothing was found
    gain = np.log(followed.psi_backward[usable] / followed.psi[usable])
    if len(gain) < _FEWEST:
        return Finding(name, Verdict.UNTOLD, followed.shortage)
    middle = float(np.median(gain))
    chance = float(wilcoxon(gain).pvalue) if gain.any() else 1.0  # by ranks: turning stretches gain many times as much
    psi, backward = float(followed.psi[usable].mean()), float(followed.psi_backward[usable].mean())
    numbers = {"psi": psi, "psi_backward": backward, "log_ratio": middle, "chance": chance}
    both = f"psi per point is {psi:.3f} as recorded and {backward:.3f} with every revolution swept backward"
    if abs(middle) < _LEAST_GAIN or chance > _CHANCE:
        return Finding(name, Verdict.UNTOLD, f"{both}: alike; faster or turning stretches would tell", numbers)
    if middle > 0.0:
        return Finding(name, Verdict.OK, both, numbers)
    remedy = "azimuths seem to be stored against the direction of rotation: bring them in the order they were measured in"
    return Finding(name, Verdict.SUSPICIOUS, f"{both}; {remedy}", numbers)


def check_mirror(recording: Recording, followed: Followed, odometry: Trajectory | None) -> Finding:
    """Whether the radar turns left where odometry does."""
    name = "direction of rotation"
    if odometry is None or len(followed.steps.begins_us) < _FEWEST:
        reason = "psi is the same for a recording and its mirror image"
        return Finding(name, Verdict.UNTOLD, _why(followed, odometry, reason))
    measured, _, given = _yaw_rates(recording, followed.steps, odometry)
    same, opposite = (float(np.min(np.mean((measured - sign * given) ** 2, axis=1))) for sign in (1.0, -1.0))
    numbers = {"rms_as_assumed_rad_s": same**0.5, "rms_mirrored_rad_s": opposite**0.5}
    turning = float(np.sqrt(np.mean(followed.steps.of(odometry)[:, 2] ** 2)))
    ratio = opposite / max(same, _RATE_FLOOR**2)
    if turning < _LEAST_TURN or 1.0 / _MIRRORED < ratio < _MIRRORED:
        return Finding(name, Verdict.UNTOLD, f"odometry turns by {turning:.3f} rad/s only, or unlike the radar", numbers)
    both = f"yaw rates differ from odometry's by {same**0.5:.3f} rad/s, mirrored by {opposite**0.5:.3f} rad/s"
    if ratio > 1.0:
        return Finding(name, Verdict.OK, both, numbers)
    remedy = "the radar seems to turn the other way round: see sensor.clockwise, or odometry's sign of yaw"
    return Finding(name, Verdict.SUSPICIOUS, f"{both}; {remedy}", numbers)


def check_stamp(recording: Recording, followed: Followed, odometry: Trajectory | None) -> Finding:
    """Whether odometry's yaw rate fits the radar's best at the stamps as they are."""
    name = "stamp convention"
    if odometry is None or len(followed.steps.begins_us) < _FEWEST:
        return Finding(name, Verdict.UNTOLD, _why(followed, odometry, "only another clock's motion shows a shift"))
    measured, shifts, given = _yaw_rates(recording, followed.steps, odometry)
    given *= 1.0 if np.sum(given @ measured) >= 0.0 else -1.0  # a mirrored recording is another check's matter
    rest = given - measured
    rest -= rest.mean(axis=1, keepdims=True)  # the gyro's bias
    rms = np.sqrt(np.mean(rest**2, axis=1))
    best = int(np.argmin(rms))
    slope = float(np.std(np.gradient(given, shifts * 1e-6, axis=0)[best]))  # of the yaw rate over the shift [rad/s^2]
    shift, error = shifts[best] * 1e-6, max(float(rms[best]), _RATE_FLOOR) / max(slope, 1e-9) / np.sqrt(len(measured))
    explained = 1.0 - float(rms[best]) ** 2 / max(float(np.var(measured)), _RATE_FLOOR**2)
    numbers = {"shift_s": shift, "shift_error_s": error, "explained": explained}
    if explained < _EXPLAINED or 3.0 * error > 0.25 * recording.revolution_s or best in (0, len(shifts) - 1):
        return Finding(name, Verdict.UNTOLD, "odometry's yaw rate changes too little, or unlike the radar's", numbers)
    fits = f"odometry's yaw rate fits best {abs(shift):.2f} s {'later' if shift > 0.0 else 'earlier'}"
    if abs(shift) < 0.5 * recording.revolution_s:
        return Finding(name, Verdict.OK, f"{fits}, within half a turn of {recording.revolution_s:.2f} s", numbers)
    meant = "the start of the revolution, not the end" if shift > 0.0 else "the end of the revolution, not the start"
    remedy = f"stamps seem to mean {meant} (sensor.stamp), or the clocks differ"
    return Finding(name, Verdict.SUSPICIOUS, f"{fits}; {remedy}", numbers)


def check_scale(recording: Recording, followed: Followed, odometry: Trajectory | None) -> Finding:
    """Whether the radar's speed is odometry's, as far as the length of a range bin goes."""
    name = "range resolution"
    if odometry is None or len(followed.steps.begins_us) < _FEWEST:
        return Finding(name, Verdict.UNTOLD, _why(followed, odometry, "a map scaled as a whole is as crisp"))
    measured, given = followed.steps.twists[:, 0], followed.steps.of(odometry)[:, 0]
    fast = np.abs(given) > _LEAST_SPEED
    if np.count_nonzero(fast) < _FEWEST:
        return Finding(name, Verdict.UNTOLD, f"odometry is slower than {_LEAST_SPEED:.0f} m/s")
    ratio = float(np.sum(measured[fast] * given[fast]) / np.sum(given[fast] ** 2))
    numbers = {"speed_ratio": ratio, "range_resolution_m": recording.range_resolution}
    says = f"the radar's speed is {ratio:.3f} times odometry's"
    if abs(ratio - 1.0) < _WRONG_SCALE:
        return Finding(name, Verdict.OK, f"{says} with bins of {recording.range_resolution:.4g} m", numbers)
    resolution = recording.range_resolution / ratio if ratio > 0.1 else None
    fitting = "they have little in common" if resolution is None else f"bins of {resolution:.4g} m would fit"
    remedy = f"with bins of {recording.range_resolution:.4g} m; {fitting} (--range-resolution), or odometry's scale is off"
    return Finding(name, Verdict.SUSPICIOUS, f"{says} {remedy}", numbers)


def _why(followed: Followed, odometry: Trajectory | None, reason: str) -> str:
    return f"no odometry: {reason}" if odometry is None else followed.shortage


def _yaw_rates(
    recording: Recording, steps: Steps, odometry: Trajectory
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Yaw rates (S,) of the radar, shifts (K,) [us] of up to a turn and a half, odometry's yaw rates (K, S) at them."""
    shifts = np.round(np.linspace(-1.5, 1.5, 61) * recording.revolution_s * 1e6).astype(np.int64)
    return steps.twists[:, 2], shifts, np.array([steps.of(odometry, shift)[:, 2] for shift in shifts.tolist()])


def _reversed(scan: Scan) -> Scan:
    """The same returns, measured in the opposite order."""
    r = scan.returns
    times = scan.t0 + scan.t1 - r.times
    order = np.argsort(times, kind="stable")
    return Scan(scan.t0, scan.t1, Returns(r.ranges[order], r.azimuths[order], times[order], r.intensities[order]))


def _per_point(tracked: Tracked) -> float:
    """Psi per point; NaN where there are no points or the track was lost."""
    points = len(tracked.evaluation.matched)
    return tracked.evaluation.psi / points if points else float("nan")
