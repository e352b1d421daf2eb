"""The scale of a run's map, held against odometry and GNSS: psi is the same for a map and a scaled copy of it."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.verdict import Finding, VerdictStatus
from mqslam.backend.sensors.gnss import FixUse
from mqslam.check.checks import LEAST_SPEED
from mqslam.check.stretches import FEWEST_STEPS
from mqslam.core.recording import Recording
from mqslam.core.trajectory import Trajectory
from mqslam.errors import Remedy
from mqslam.solution import Run

_SPAN_US: Final = 1_000_000  # over which speeds are compared [us]: long against what single motions err by
_UNITS: Final = {"km/h": 1.0 / 3.6, "miles per hour": 0.44704, "mm/s": 1e-3, "cm/s": 1e-2}  # [m/s]
# A run whose speed differs from odometry's by a larger share, or the distances between GNSS fixes from those in the
# trajectory, has the wrong length of range bins, or odometry the wrong scale. Worn tyres and slip are a few percent.
_WRONG_SCALE = 0.1
_SAME_UNIT: Final = 0.1  # by which a wheel's scale, or a range bin's, may be off besides


def judge_scale(run: Run) -> list[Finding]:
    """Returns that odometry or fixes contradict the trajectory's scale; nothing where they do not, or there are too few."""
    reasons, ratio, fixes = [], measure_ratio(run), run.sensors.fixes
    if ratio is not None and _is_wrong(ratio):
        fits = f"range bins {1.0 / ratio:.3g} times as long would fit: {Remedy.GIVE_RANGE_RESOLUTION}"
        agreed = _shows_scale(fixes) and not (fixes and fixes.stretch and _is_wrong(fixes.stretch))
        remedy = "mend odometry's speeds, since GNSS agrees with the radar" if agreed else f"or {fits}"
        wrong = f"odometry's scale is wrong{_guess_unit(ratio)}"
        reasons.append(f"the trajectory is {ratio:.3g} times as fast as odometry: {wrong}, {remedy}")
    if fixes is not None and fixes.stretch is not None and _is_wrong(fixes.stretch):
        reasons.append(
            f"GNSS fixes lie {fixes.stretch:.3g} times as far apart as the trajectory has them: range bins "
            f"{fixes.stretch:.3g} times as long would fit: {Remedy.GIVE_RANGE_RESOLUTION}"
        )
    return [Finding(VerdictStatus.WARN, reason) for reason in reasons]


def _shows_scale(fixes: FixUse | None) -> bool:
    """Returns whether fixes show the scale: they are used, or contradict it."""
    return fixes is not None and (fixes.edges is not None or fixes.stretch is not None)


def _guess_unit(ratio: float) -> str:
    """Returns the unit that odometry's speeds seem to have, if the radar is that many times as fast."""
    unit = next((unit for unit, size in _UNITS.items() if abs(ratio / size - 1.0) < _SAME_UNIT), None)
    return f", as if its speeds were in {unit}" if unit else ""


def _is_wrong(ratio: float) -> bool:
    """Returns whether a ratio of two scales is too far from 1."""
    return not 1.0 / (1.0 + _WRONG_SCALE) <= ratio <= 1.0 + _WRONG_SCALE


def list_unknown_scale(run: Run, recording: Recording) -> list[str]:
    """Returns on what the scale of the map rests, where nothing is held against it: psi is the same for a scaled copy."""
    if measure_ratio(run) is not None or _shows_scale(run.sensors.fixes):
        return []
    known = "assumed" if recording.is_resolution_assumed else "stated"
    length = f"range bins of {recording.range_resolution:.4g} m, as is {known}"
    return [f"the scale of the map rests on {length}: neither odometry nor GNSS is held against it"]


def measure_ratio(run: Run) -> float | None:
    """Returns how many times as fast as odometry the trajectory is; None where the run has no odometry, or hardly moves."""
    if not run.odometry_factors:
        return None
    stamps = run.optimised.stamps_us
    ends = np.searchsorted(stamps, stamps + _SPAN_US)
    begins = np.flatnonzero(ends < len(stamps))
    speeds = [_find_speeds(track, begins, ends[begins]) for track in (run.optimised, run.odometry)]
    fast = np.maximum(*speeds) > LEAST_SPEED
    if np.count_nonzero(fast) < FEWEST_STEPS:
        return None
    own, given = (float(np.median(speed[fast])) for speed in speeds)
    return own / given if min(own, given) > 0.0 else None


def _find_speeds(track: Trajectory, begins: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.float64]:
    """Returns the mean speeds (N,) [m/s] between scans, along the straight line."""
    moved = track.poses[ends, :2] - track.poses[begins, :2]
    return np.asarray(np.hypot(moved[:, 0], moved[:, 1]) / ((track.stamps_us[ends] - track.stamps_us[begins]) * 1e-6))
