"""Checks the speed of a trajectory by pairs of successive scans, which show errors too large for a window to measure.

A window's correction is searched for near the trajectory. If the trajectory is farther off, the search ends in another
minimum of psi, and the window's inflation means nothing. Two successive scans are registered over all plausible speeds, so
this check has no such limit.

In a gap of the trajectory the speed is interpolated. There the trajectory only states how far apart the ends of the gap are.
The chained motions of the scans in the gap confirm or contradict this distance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.registration import (
    Registration,
    Shared,
    ask_of_single_scans,
    compute_far_reach,
    fits_far_better,
    is_of_beams,
    measure_span,
    register,
)
from mqslam.auditing.sizes import WINDOW
from mqslam.auditing.tracks import Track, find_gaps
from mqslam.auditing.verdict import WINDOWS_FAIL, WINDOWS_WARN, Cause, Finding, Share, VerdictStatus
from mqslam.config import EstimatorConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.wording import count_of
from mqslam.execution.progress import Progress, count_items


@dataclass(frozen=True, slots=True)
class CaptureRange:
    """The largest errors of a trajectory that windows can measure; the speed checks look for larger errors.

    Args:
        window_m: largest correction that the search in a window surely finds [m].
        speed_mps: largest error of the speed that a window can measure [m/s]: `window_m` divided by a window's duration.
    """

    window_m: float
    speed_mps: float


@dataclass(frozen=True, slots=True)
class SpeedCheck:
    """The motion between two successive scans compared with the trajectory's motion.

    Args:
        error: (3,) correction of the trajectory's mean velocity between the scans, in the frame of the later scan [m/s, m/s,
            rad/s].
        sure: whether the two scans constrain every direction and fit nowhere else as well. If the error is beyond the
            capture range, the scans must also fit clearly worse where the trajectory places them, and the pattern of a
            lidar's beams must not explain this.
    """

    error: se2.Array
    sure: bool

    @property
    def error_mps(self) -> float:
        """Size of the error of the speed [m/s]."""
        return float(np.hypot(self.error[0], self.error[1]))


def find_capture_range(revolution_s: float, estimator: EstimatorConfig) -> CaptureRange:
    """Returns the largest errors of a trajectory that the windows of its map can measure.

    The widest search for a window's best map begins with neighbourhoods of radius `estimator.s_start` [m]. A correction that
    moves the ends of a window farther than this relative to each other moves points out of each other's neighbourhood.

    Args:
        revolution_s: usual duration of a scan [s].
        estimator: settings of the score.
    """
    reach_m = estimator.s_start
    return CaptureRange(reach_m, reach_m / (WINDOW * revolution_s))


def check_speeds(
    shared: Shared, middles: Sequence[int], known: NDArray[np.bool_], engine: Engine, progress: Progress
) -> list[SpeedCheck | None]:
    """Compares the motions from some sweeps to the next sweeps with the trajectory's motions.

    Where two scans in a gap contradict the trajectory, the check is sure only if the scans of the whole gap contradict it.

    Args:
        shared: points under the trajectory to judge, settings of the audit and settings of the score.
        middles: numbers of the sweeps whose motion to the next sweep is checked.
        known: (S,) mask of the sweeps that lie in no gap of the trajectory.
        engine: where the motions are compared; the result does not depend on it.
        progress: called as motions are compared.

    Returns:
        one check per entry of `middles`; None where either scan holds too few points.
    """
    sweeps, _, estimator = shared
    capture = find_capture_range(sweeps.revolution_s, estimator)
    checks = engine.map(check_speed, shared, list(middles), count_items(progress, "speeds", len(middles)))
    inside = {k: begin + int(known[begin]) for k, begin in enumerate(middles) if not known[begin : begin + 2].all()}
    off = [k for k in inside if contradicts(checks[k], capture)]
    if sweeps.track is None or not off:
        return checks
    steps = {k: find_gaps(sweeps.track, sweeps.times[[within]])[0] for k, within in inside.items()}
    doubtful = sorted({steps[k] for k in off})
    right = set(doubtful) - _find_wrong(doubtful, sweeps.track, shared, engine, progress)
    return [
        replace(check, sure=False) if check is not None and steps.get(k) in right else check
        for k, check in enumerate(checks)
    ]


def _find_wrong(
    gaps: Sequence[tuple[float, float]], track: Track, shared: Shared, engine: Engine, progress: Progress
) -> set[tuple[float, float]]:
    """Returns the gaps (begin, end) [s] between whose ends the scans show a different distance than the trajectory."""
    sweeps, settings, estimator = shared
    inner = {gap: _pick_inside(gap, sweeps.times) for gap in gaps}
    pairs = sorted({begin for begins in inner.values() for begin in begins})
    curved = replace(sweeps, poses=se2.smooth(track.times, track.poses, sweeps.times))  # points are placed by this curve
    report = count_items(progress, "speeds in gaps", len(pairs))
    motions = dict(zip(pairs, engine.map(_measure_twist, (curved, settings, estimator), pairs, report), strict=True))
    longest_s, speed_mps = WINDOW * sweeps.revolution_s, find_capture_range(sweeps.revolution_s, estimator).speed_mps
    wrong = set()
    for gap, begins in inner.items():
        found_m = _chain_across(gap, sweeps.times, {k: motions[k] for k in begins}, longest_s)
        begin, end = track.poses[np.searchsorted(track.times, gap), :2]
        if found_m is not None and abs(found_m - np.hypot(*(end - begin))) > speed_mps * (gap[1] - gap[0]):
            wrong.add(gap)
    return wrong


def _pick_inside(gap: tuple[float, float], times: NDArray[np.float64]) -> range:
    """Returns the numbers of the sweeps whose motion to the next sweep overlaps a gap in time.

    Args:
        gap: begin and end of the gap [s].
        times: (S,) times of all sweeps [s].
    """
    first = int(np.searchsorted(times, gap[0], side="right")) - 1
    last = int(np.searchsorted(times, gap[1], side="left"))
    return range(max(first, 0), min(last, len(times) - 1))


def _chain_across(
    gap: tuple[float, float], times: NDArray[np.float64], twists: Mapping[int, se2.Array | None], longest_s: float
) -> float | None:
    """Returns the distance [m] between the ends of a gap by its chained motions, which are interpolated where unknown.

    Args:
        gap: begin and end of the gap [s].
        times: (S,) times of the sweeps [s].
        twists: mean twist (3,) from each sweep of the gap to the next sweep [m/s, m/s, rad/s]; None where it is unknown.
        longest_s: longest time over which unknown motions are interpolated [s]; if a time without known motions is
            longer, None is returned.
    """
    known = [k for k, twist in twists.items() if twist is not None]
    middles = (times[known] + times[[k + 1 for k in known]]) / 2.0
    if not known or np.diff(middles, prepend=gap[0], append=gap[1]).max() > longest_s:
        return None
    edges = times[min(twists) : max(twists) + 2].copy()
    edges[[0, -1]] = gap
    at = (times[list(twists)] + times[[k + 1 for k in twists]]) / 2.0
    rows = np.array([twists[k] for k in known])
    steps = np.column_stack([np.interp(at, middles, rows[:, axis]) for axis in range(3)])
    x, y, _ = se2.integrate_steps(se2.exp(steps, np.diff(edges)))[-1]
    return float(np.hypot(x, y))


def _measure_twist(shared: Shared, begin: int) -> se2.Array | None:
    """Measures the mean twist (3,) from the sweep `begin` to the next sweep [m/s, m/s, rad/s]; None if it is not sure."""
    sweeps = shared[0]
    measured = _register_next(shared, begin)
    if measured is None or not measured[1].sure:
        return None
    registration = measured[0]
    duration_s = float(sweeps.times[begin + 1] - sweeps.times[begin])
    return np.asarray(se2.log(se2.compose(registration.between, registration.offset)) / duration_s)


def check_speed(shared: Shared, begin: int) -> SpeedCheck | None:
    """Compares the motion from the sweep `begin` to the next sweep with the trajectory's motion.

    Returns None if either sweep has too few points.
    """
    measured = _register_next(shared, begin)
    return None if measured is None else measured[1]


def _register_next(shared: Shared, begin: int) -> tuple[Registration, SpeedCheck] | None:
    """Registers the sweep `begin + 1` on the sweep `begin`, and compares their motion with the trajectory's.

    Returns None if either sweep has too few points.
    """
    sweeps, settings, estimator = shared
    span_s = measure_span(sweeps, begin)
    reach = compute_far_reach(span_s, settings)
    pair = [begin], [begin + 1]
    registration = register(sweeps, (begin, begin + 1), pair, reach, ask_of_single_scans(settings), estimator)
    if registration is None:
        return None
    check = SpeedCheck(registration.offset / span_s, registration.unrivalled)
    if contradicts(check, find_capture_range(sweeps.revolution_s, estimator)):  # the wide search may be wrong
        is_sure = fits_far_better(registration) and not is_of_beams(registration, pair, sweeps, estimator)
        return registration, replace(check, sure=is_sure)
    return registration, check


def contradicts(check: SpeedCheck | None, capture: CaptureRange) -> bool:
    """Returns whether a check is sure and finds an error of the speed that is larger than a window can measure."""
    return check is not None and check.sure and check.error_mps > capture.speed_mps


def judge_speeds(checks: Sequence[SpeedCheck | None], capture: CaptureRange, *, is_of_run: bool = False) -> list[Finding]:
    """Judges a map by its speed checks; returns one finding, or an empty list if no check is sure.

    The share of wrong speeds has the same limits as the share of torn windows.

    Args:
        checks: the speed checks of all windows; None for a window without a check.
        capture: the largest errors that windows can measure.
        is_of_run: whether a run made the trajectory, so that the trajectory surely belongs to this recording.
    """
    sure = [check for check in checks if check is not None and check.sure]
    if not sure:
        return []
    off = [check for check in sure if contradicts(check, capture)]
    share = Share(len(off), len(sure))
    if not off:
        reason = (
            f"the scans confirm the speed at {count_of(share.total, 'place')} to within {capture.speed_mps:.2g} m/s, and "
            "the windows measure smaller errors"
        )
        return [Finding(VerdictStatus.PASS, reason)]
    median = float(np.median([check.error_mps for check in off]))
    reason = (
        f"the scans contradict the trajectory's speed at {share.count} of {count_of(share.total, 'place')}, by {median:.1f} "
        f"m/s in the median: a window cannot measure corrections beyond {capture.window_m:.2g} m ({capture.speed_mps:.2g} "
        "m/s), so that inflation means nothing there"
    )
    status = VerdictStatus.WARN if share.is_above(WINDOWS_WARN) else VerdictStatus.PASS
    explanation = f"the trajectory's speed is wrong by {median:.1f} m/s at {count_of(share.count, 'place')}"
    if share.is_above(WINDOWS_FAIL):
        status = VerdictStatus.FAIL
        if 2 * share.count >= share.total and is_of_run:
            explanation = f"the front end measured most motions wrongly: {explanation}"
        elif 2 * share.count >= share.total:
            explanation = (
                "the trajectory belongs to another recording, or its clock, its scale or the frame of its poses (the mount "
                "of the sensor, the order of quaternions) is wrong"
            )
    return [Finding(status, reason, cause=Cause.RECORDING, explanation=explanation)]
