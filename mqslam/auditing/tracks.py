"""Tests a trajectory by its poses alone: where poses are missing, where it jumps, and which scans it does not cover.

These tests come before all others, since they find faults of the trajectory that no window shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.sizes import WINDOW
from mqslam.auditing.verdict import Cause, Finding, VerdictStatus
from mqslam.config import AuditConfig
from mqslam.core import se2
from mqslam.core.wording import count_of, describe_times
from mqslam.errors import Remedy

# A single step of a trajectory is a jump only if it takes a larger acceleration than this [m/s^2]: tyres give a vehicle
# about as much as gravity.
_JUMP_MPS2 = 9.81
# A single step of a trajectory is a jump in yaw only if it takes a larger angular acceleration than this [rad/s^2], which
# is beyond what a robot that turns on the spot reaches.
_JUMP_RADPS2 = 10.0
# A jump differs from the steps around it by more than this many times the largest such difference of the other steps, so
# that noise of the poses is no jump.
_JUMP_FACTOR = 3.0
# Only steps whose difference from the steps around them lies above this quantile of all differences may be jumps.
_JUMP_QUANTILE = 0.9
# If a trajectory leaves a larger share of the scans than this uncovered, its stamps may not fit the recording's.
_UNCOVERED_WARN = 0.5
# If a trajectory leaves a larger share of the scans than this uncovered, it covers only a part of the recording, and the
# rest is not judged. A smaller share is tolerated, since a SLAM system may lack its first poses.
_PART_WARN = 0.1

_LISTED: Final = 3  # a sentence names at most this many stretches or jumps, so that it stays readable
_MOST: Final = 0.5  # by definition: most scans are more than half of them
_CLOSE_TURNS: Final = 0.5  # by definition: a scan has its own pose if a pose lies within half a revolution of its start
_LONGEST_TURNS: Final = 1.5  # by definition: poses of all scans lie one revolution apart, those of every second scan two
_INSIDE: Final = np.array([0.25, 0.5, 0.75])  # numerical: shares of the way between two poses at which the curve is checked
_SIDE: Final = 2  # a step is compared with this many steps on either side: their median survives one wrong step


@dataclass(frozen=True, slots=True)
class Track:
    """The poses of a trajectory as they were given, before anything was interpolated.

    Args:
        times: (M,) times of the poses [s] since the recording's start, increasing.
        poses: (M, 3) poses x, y [m], yaw [rad] of the sensor in the map's frame.
        scans: number of scans of the recording.
        uncovered: number of these scans that the trajectory does not cover.
        extrinsics: (3,) pose x, y [m], yaw [rad] of the sensor in the frame whose motion the given trajectory describes,
            such as the vehicle's frame; None if the user cannot choose the pose.
        time_offset_s: time that was added to the stamps of the given trajectory [s]; None if the user cannot choose it.
    """

    times: NDArray[np.float64]
    poses: se2.Array
    scans: int
    uncovered: int
    extrinsics: se2.Array | None = None
    time_offset_s: float | None = None


@dataclass(frozen=True, slots=True)
class Jump:
    """A single step of a trajectory that no vehicle can make.

    Args:
        t0, t1: times at which the step begins and ends [s] since the recording's start.
        distance_m: distance of its end from the place that the median motion of the steps around it would have reached [m].
        angle_rad: difference between its turn and the turn of this median motion [rad].
    """

    t0: float
    t1: float
    distance_m: float
    angle_rad: float


def judge_track(
    track: Track,
    times: NDArray[np.float64],
    revolution_s: float,
    settings: AuditConfig,
    odometry: se2.Array | None = None,
) -> list[Finding]:
    """Returns the findings on gaps and jumps of a trajectory; an empty list if it has none of these faults.

    Poses before the first scan and after the last scan are not judged, since they move no point.

    Args:
        track: the trajectory.
        times: (S,) starts of the scans that the trajectory covers [s] since the recording's start.
        revolution_s: usual duration of a scan [s].
        settings: settings of the audit.
        odometry: (M, 3) poses by odometry at the times of the trajectory's poses; None without odometry.
    """
    findings = []
    span_s = WINDOW * revolution_s
    inside = mark_interpolated(track, times, revolution_s)
    if inside.any():
        share = float(np.mean(inside))
        where = _list_spans(find_gaps(track, times[inside]), float(times[-1]))
        why = f"its poses are farther apart than a window is long ({span_s:.2g} s), so that its motion there is interpolated"
        if share > _MOST:
            sparse = f"the trajectory is too sparse to be judged {where} ({share:.0%} of the scans)"
            reason = f"{sparse}: {why}; {Remedy.GIVE_MORE_POSES}"
            findings.append(Finding(VerdictStatus.NOT_JUDGED, reason))
        else:
            reason = f"the trajectory has a gap {where}: {why}, and windows there are left undecided"
            explanation = f"poses are missing {where}"
            findings.append(Finding(VerdictStatus.WARN, reason, cause=Cause.NO_POSES, explanation=explanation))
    first, last = float(times[0]), float(times[-1]) + revolution_s
    jumps = [jump for jump in find_jumps(track, span_s, settings) if jump.t1 > first and jump.t0 < last]
    if jumps:
        named = [f"at {jump.t0:.1f} s {_describe_jump(jump)}" for jump in jumps]
        reason = f"the trajectory jumps {_join(named)}: no vehicle moves like that"
        driven = [] if odometry is None else find_jumps(replace(track, poses=odometry), span_s, settings)
        if {jump.t0 for jump in jumps} <= {jump.t0 for jump in driven}:
            reason += "; the odometry jumps there, too"
        findings.append(Finding(VerdictStatus.WARN, reason, cause=Cause.JUMP, explanation=reason))
    return findings


def mark_interpolated(track: Track, times: NDArray[np.float64], revolution_s: float) -> NDArray[np.bool_]:
    """Returns a mask (S,) of the scans that lie in gaps of the trajectory.

    A scan lies in a gap if the poses before and after it are farther apart in time than a window is long, and both are more
    than half a revolution from the start of the scan. A gap of the recording itself contains no scan to mark.

    Args:
        track: the trajectory.
        times: (S,) starts of the scans [s] since the recording's start.
        revolution_s: usual duration of a scan [s].
    """
    if len(track.times) < 2:
        return np.zeros(len(times), dtype=np.bool_)
    before = _find_steps(track, times)
    since, until = times - track.times[before], track.times[before + 1] - times
    close_s = _CLOSE_TURNS * revolution_s
    is_wide = since + until > WINDOW * revolution_s
    return np.asarray(is_wide & (since > close_s) & (until > close_s))


def measure_doubt(track: Track, times: NDArray[np.float64], revolution_s: float, range_m: float) -> NDArray[np.float64]:
    """Returns the distance (S,) [m] by which interpolation between given poses may have moved the points of each scan.

    Between two poses the sensor is taken to move on a smooth curve (`se2.smooth`). The difference between this curve and a
    motion with a constant twist (`se2.interpolate`) is taken as the error of the curve. There is no such error where every
    scan has a pose, or across a pause of the recording that has a pose at either end.

    Args:
        track: the trajectory.
        times: (S,) starts of the scans [s] since the recording's start.
        revolution_s: usual duration of a scan [s].
        range_m: root mean square distance of the points from the sensor [m], which converts an error of yaw to metres.
    """
    if len(track.times) < 3:
        return np.zeros(len(times))
    durations = np.diff(track.times)
    at = (track.times[:-1, None] + durations[:, None] * _INSIDE).ravel()
    curve, chord = (fit(track.times, track.poses, at) for fit in (se2.smooth, se2.interpolate))
    off = se2.wrapped_between(chord, curve)
    off_m = (np.hypot(off[:, 0], off[:, 1]) + range_m * np.abs(off[:, 2])).reshape(-1, len(_INSIDE)).max(axis=1)
    is_dense = durations <= _LONGEST_TURNS * revolution_s
    off_m[[0, -1]] *= 2.0  # beyond the ends no pose shows how the curve goes on
    own = have_own_pose(track, times, revolution_s)
    within = _find_steps(track, times[~own])
    is_dense |= ~np.isin(np.arange(len(durations)), within)
    off_m[is_dense] = 0.0
    first, last = _find_steps(track, times) - 1, _find_steps(track, times + revolution_s) + 1  # neighbours shape a curve
    return np.array([off_m[max(a, 0) : b + 1].max() for a, b in zip(first.tolist(), last.tolist(), strict=True)])


def have_own_pose(track: Track, times: NDArray[np.float64], revolution_s: float) -> NDArray[np.bool_]:
    """Returns a mask (S,) of the scans that have a pose within half a revolution of their start, at `times` (S,) [s]."""
    before = _find_steps(track, times)
    apart = np.minimum(np.abs(times - track.times[before]), np.abs(track.times[before + 1] - times))
    return np.asarray(apart <= _CLOSE_TURNS * revolution_s)


def judge_doubt(doubt_m: NDArray[np.float64], settings: AuditConfig) -> list[Finding]:
    """Returns a finding if poses are too sparse for the vehicle's turns, so that errors could hide; else an empty list.

    Args:
        doubt_m: (S,) distance by which interpolation between given poses may have moved the points of each scan [m].
        settings: settings of the audit.
    """
    unsure = int(np.count_nonzero(doubt_m > settings.jump_m))
    if not unsure:
        return []
    where = f"in {count_of(unsure, 'scan')} interpolation may be off by up to {doubt_m.max():.2f} m"
    sparse = f"the poses of the trajectory are too sparse for its turns: {where}, which hides smaller errors"
    reason = f"{sparse}; {Remedy.GIVE_MORE_POSES}"
    return [Finding(VerdictStatus.PASS, reason, judged=False)]


def find_gaps(track: Track, times: NDArray[np.float64]) -> list[tuple[float, float]]:
    """Returns the intervals (begin, end) [s] between successive poses that contain any of the times (S,) [s].

    Adjacent intervals are joined.
    """
    gaps: list[tuple[float, float]] = []
    for step in np.unique(_find_steps(track, times)).tolist():
        begin, end = float(track.times[step]), float(track.times[step + 1])
        if gaps and gaps[-1][1] == begin:
            gaps[-1] = (gaps[-1][0], end)
        else:
            gaps.append((begin, end))
    return gaps


def find_jumps(track: Track, longest_s: float, settings: AuditConfig) -> list[Jump]:
    """Finds the steps of a trajectory that no vehicle can make and that stand out from its other steps.

    A step is compared with the median motion of the two steps before it and the two after it. It is a jump if the
    difference, in position or in yaw, (1) exceeds the tolerance of a torn revisit, (2) takes a larger acceleration than a
    vehicle can have, and (3) stands out from the differences of all steps, since the whole trajectory may be noisy.

    Args:
        track: the trajectory.
        longest_s: steps that take longer than this [s] are gaps: they count neither as jumps nor as steps around a jump.
        settings: settings of the audit.
    """
    knots = se2.select_apart(track.times)
    times, poses = track.times[knots], track.poses[knots]
    durations = np.diff(times)
    usable = durations <= longest_s
    twists = se2.log(se2.wrapped_between(poses[:-1], poses[1:])) / durations[:, None]
    padded = np.pad(np.where(usable[:, None], twists, np.nan), ((_SIDE, _SIDE), (0, 0)), constant_values=np.nan)
    beside = np.stack([padded[shift : shift + len(twists)] for shift in range(2 * _SIDE + 1) if shift != _SIDE])
    usable &= np.count_nonzero(np.isfinite(beside[..., 0]), axis=0) > _SIDE  # of fewer, one wrong step could be the median
    if not usable.any():
        return []
    times, durations = times[:-1][usable], durations[usable]
    off = twists[usable] - np.nanmedian(beside[:, usable], axis=0)
    distances, angles = np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])
    jumping = (distances * durations > settings.torn_m) & (distances / durations > _JUMP_MPS2)
    jumping &= _stand_out(distances)
    turning = (angles * durations > settings.torn_rad) & (angles / durations > _JUMP_RADPS2)
    jumping |= turning & _stand_out(angles)
    return [
        Jump(float(t), float(t + lasts), float(distance * lasts), float(angle * lasts))
        for t, lasts, distance, angle in np.column_stack([times, durations, distances, angles])[jumping]
    ]


def _stand_out(sizes: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Returns a mask (N,) of the sizes (N,) that stand out, since a wide gap separates them from all smaller sizes.

    The largest tenth of the sizes is sorted upwards. From the first size in it that is more than `_JUMP_FACTOR` times the
    size before it, all sizes stand out; if there is no such size, none does.
    """
    ordered = np.sort(sizes)
    largest = ordered[int(_JUMP_QUANTILE * (len(ordered) - 1)) :]
    gaps = np.flatnonzero(largest[1:] > _JUMP_FACTOR * largest[:-1])
    return np.asarray(sizes >= largest[gaps[0] + 1]) if len(gaps) else np.zeros(len(sizes), dtype=np.bool_)


def _find_steps(track: Track, times: NDArray[np.float64]) -> NDArray[np.int64]:
    """Returns the index (S,) of the last pose at or before each of the times (S,) [s], from 0 to the last index but one."""
    return np.clip(np.searchsorted(track.times, times, side="right") - 1, 0, len(track.times) - 2)


def judge_cover(track: Track) -> list[Finding]:
    """Returns a finding if a trajectory covers less than 90 % of the scans, else an empty list.

    If it covers less than half of them, its stamps may be wrong; with fewer scans than in a window, it is `not judged`.
    """
    if track.uncovered <= _PART_WARN * track.scans:
        return []
    covered, status = _count_covered(track), VerdictStatus.WARN
    where = f"{describe_times(float(track.times[0]), float(track.times[-1]))}: the other scans were not judged"
    reason = f"the trajectory covers only a part of the recording, {covered} {where}"
    if track.uncovered > _UNCOVERED_WARN * track.scans:
        reason = f"the trajectory covers only {covered}, {where}; check whether the stamps fit the recording's"
        status = VerdictStatus.NOT_JUDGED if track.scans - track.uncovered < WINDOW else status
    return [Finding(status, reason, cause=Cause.PART, explanation=reason)]


def state_cover(track: Track) -> Finding:
    """Returns the finding on a trajectory without gaps, jumps and sparse poses: how many scans it covers."""
    rest = ", and the rest lies before its first pose or after its last" if track.uncovered else ""
    covers = f"the trajectory covers {_count_covered(track)}{rest}"
    return Finding(VerdictStatus.PASS, f"{covers}; its poses alone show no gap and no jump")


def _count_covered(track: Track) -> str:
    """Returns in words how many of the scans a trajectory covers."""
    return f"{track.scans - track.uncovered} of {count_of(track.scans, 'scan')}"


def _list_spans(spans: Sequence[tuple[float, float]], last: float) -> str:
    """Describes intervals (begin, end) [s] in words; omits an end at or after `last`, the start of the last scan [s]."""
    return _join([f"from {a:.1f} s on" if b >= last else describe_times(a, b) for a, b in spans])


def _describe_jump(jump: Jump) -> str:
    """Returns the distance, the angle and the duration of a jump in words."""
    return f"by {jump.distance_m:.2f} m and {np.rad2deg(jump.angle_rad):.1f} deg in {jump.t1 - jump.t0:.2g} s"


def _join(parts: Sequence[str]) -> str:
    """Joins the first `_LISTED` parts of a sentence, and says how many more there are."""
    more = len(parts) - _LISTED
    return ", ".join([*parts[:_LISTED], *([f"and {more} more"] if more > 0 else [])])
