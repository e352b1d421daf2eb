"""Tests whether a trajectory is in the frame of its cloud, and whether another reading of the poses makes a torn map whole.

A finished cloud has the same shape in whatever frame its trajectory is given. But a sensor sees its surroundings: in the
right frame, the points of every sweep lie around the pose from which the sensor saw them.

A trajectory that is mirrored, or counts yaw clockwise, tears a map wherever the vehicle turns. If undoing one of these
errors makes the torn windows whole, this error is the cause. Missing headings show in the poses themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mqslam.auditing.registration import Shared
from mqslam.auditing.spans.robust import HUBER, measure_spread, split_into_blocks
from mqslam.auditing.speeds import check_speed, contradicts, find_capture_range
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.verdict import Cause, Finding, VerdictStatus
from mqslam.auditing.windows.windows import WindowAudit, audit_window
from mqslam.core import se2
from mqslam.core.engine import Engine

Place = Callable[[se2.Array], Sweeps]
"""A function that returns the points of a map under other poses (M, 3) x, y [m], yaw [rad] of its track."""

_FAR: Final = 0.3  # a wrong frame is off by more than this share of a sweep's spread: a one-sided view causes smaller errors
_SIGMAS: Final = 5.0  # a wrong frame is also off by more than this many standard deviations
_FEWEST: Final = 40  # fewest sweeps with points that show where the sensor was

_TURNS: Final = 0.1  # a window in which the trajectory turns by less than this [rad] looks much the same in a mirror
_TRIED: Final = 20  # other readings are tried in this many windows: those with the largest rotations
_LEAST_TORN: Final = 4  # with fewer torn windows than this no other reading is tried
_WHOLE: Final = 0.5  # share of the tried windows that the right reading makes whole and crisper
_NOT_MIRRORED: Final = "the map has no tears of the kind that a mirrored trajectory or missing headings would cause"
_LEAST_TURN: Final = 0.02  # headings are missing if they differ by at most this [rad] although the path turns
_SAME_YAW: Final = 1e-6  # numerical: yaws that differ by less than this [rad] are the same
_PATH_TURNS: Final = 0.5  # a path turns if its directions differ by more than this [rad]


def judge_frame(sweeps: Sweeps) -> Finding:
    """Judges whether the points of a finished cloud lie around the poses from which they were seen; `fail` if not.

    Args:
        sweeps: points of a finished cloud and its trajectory.
    """
    filled = np.flatnonzero(np.diff(sweeps.begins) > 0)
    if len(filled) < _FEWEST:
        reason = f"frame: only {len(filled)} scans have points, too few to tell whether the trajectory has the cloud's frame"
        return Finding(VerdictStatus.PASS, reason, judged=False)
    middles = np.array([np.median(sweeps.points[sweeps.span(k, k + 1)], axis=0) for k in filled.tolist()])
    spreads = [
        np.median(np.hypot(*(sweeps.points[sweeps.span(k, k + 1)] - middle).T))
        for k, middle in zip(filled.tolist(), middles, strict=True)
    ]
    poses = sweeps.poses[filled]
    found = _fit_frame(middles, poses)
    blocks = split_into_blocks(len(filled))
    without = [_fit_frame(np.delete(middles, block, axis=0), np.delete(poses, block, axis=0)) for block in blocks]
    moved = se2.transform(found, middles)
    off_m = float(np.sqrt(np.mean(np.sum((moved - middles) ** 2, axis=1))))
    spread = [np.mean(np.sum((se2.transform(one, middles) - moved) ** 2, axis=1)) for one in without]
    sigma_m = float(np.sqrt((len(blocks) - 1.0) / len(blocks) * np.sum(spread)))
    if off_m <= max(_FAR * float(np.median(spreads)), _SIGMAS * sigma_m):
        reason = f"the points lie around the poses from which they were seen, to within {max(off_m, sigma_m):.1f} m"
        return Finding(VerdictStatus.PASS, reason)
    reason = f"the points lie {off_m:.0f} m (± {sigma_m:.0f}) off the poses from which they were seen"
    explanation = f"the trajectory is in another frame than the cloud: {reason}; give both in one frame"
    return Finding(VerdictStatus.FAIL, reason, cause=Cause.FRAME, explanation=explanation)


def _fit_frame(middles: NDArray[np.float64], poses: se2.Array) -> se2.Array:
    """Returns the motion (3,) [m, m, rad] that moves the sweeps of a cloud to the poses from which they were seen.

    A sensor may always see more on one of its sides. This is no fault of the frame, so the mean offset of the points from
    the sensor is fitted as well.

    Args:
        middles: (N, 2) median position of the points of each sweep, in the cloud's frame [m].
        poses: (N, 3) poses x, y [m], yaw [rad] from which the sweeps were seen, in the trajectory's frame.
    """
    centre, towards = middles.mean(axis=0), poses[:, :2].mean(axis=0)
    cross = (middles - centre).T @ (poses[:, :2] - towards)
    yaw = float(np.arctan2(cross[0, 1] - cross[1, 0], cross[0, 0] + cross[1, 1]))
    start = np.append(towards - se2.transform([0.0, 0.0, yaw], centre[None])[0], yaw)
    reach_m = max(float(np.sqrt(np.mean(np.sum((middles - centre) ** 2, axis=1)))), 1.0)

    def miss(x: NDArray[np.float64]) -> NDArray[np.float64]:
        seen = se2.compose(poses, np.append(x[3:], 0.0))[:, :2]
        return np.asarray((se2.transform(x[:3], middles) - seen).ravel())

    spread_m = measure_spread(miss(np.append(start, np.zeros(2))))
    fitted = least_squares(
        miss, np.append(start, np.zeros(2)), loss="huber", f_scale=HUBER * spread_m, x_scale=[1, 1, 1 / reach_m, 1, 1]
    )
    return np.asarray(fitted.x[:3])


class Reading(NamedTuple):
    """Another way to read the poses of a trajectory, such as mirrored.

    Args:
        name: fault of the trajectory if the map is whole under this reading, as a sentence.
        remedy: how to correct the trajectory.
        signs: factors (1 or -1) of x, y and yaw that convert the poses to this reading.
    """

    name: str
    remedy: str
    signs: tuple[float, float, float]


def _misses_headings(poses: se2.Array) -> bool:
    """Returns whether all poses (M, 3) have about the same yaw although their path turns."""
    along = np.diff(poses[:, :2], axis=0)
    along = along[np.hypot(*along.T) > 1e-3]
    if len(along) < 2 or np.ptp(np.unwrap(poses[:, 2])) > _LEAST_TURN:
        return False
    return bool(np.ptp(np.unwrap(np.arctan2(along[:, 1], along[:, 0]))) > _PATH_TURNS)


_READINGS: Final = (
    Reading("the trajectory is mirrored", "seen from above, y must point left of x and yaw turn left", (1.0, -1.0, -1.0)),
    Reading("the trajectory counts yaw the other way", "seen from above, yaw must turn left", (1.0, 1.0, -1.0)),
)


def judge_readings(shared: Shared, windows: Sequence[WindowAudit], place: Place, engine: Engine) -> Finding:
    """Judges whether a map is torn because its trajectory is mirrored, counts yaw the other way or has no headings.

    Args:
        shared: points under the trajectory to judge, settings of the audit and settings of the score.
        windows: windows of the map. If fewer than `_LEAST_TORN` of them are torn, the map passes. If the trajectory
            turns in fewer than `_LEAST_TORN` of them, only missing headings can be judged.
        place: returns the points of the map under other poses (M, 3) x, y [m], yaw [rad] of the trajectory.
        engine: where windows are judged; the result does not depend on it.
    """
    sweeps, settings, estimator = shared
    track = sweeps.track
    assert track is not None  # a cloud without a trajectory has no poses to read
    if sum(window.torn for window in windows) < _LEAST_TORN:
        return Finding(VerdictStatus.PASS, _NOT_MIRRORED)
    if _misses_headings(track.poses):
        reason = "the headings of the trajectory are missing: all poses look the same way while the path turns"
        explanation = f"{reason}; give poses with their yaw"
        return Finding(VerdictStatus.FAIL, reason, cause=Cause.MIRROR, explanation=explanation)
    turning = [window for window in windows if _measure_turn(sweeps, window) > _TURNS]
    tried = sorted(turning, key=lambda window: -_measure_turn(sweeps, window))[:_TRIED]
    if len(tried) < _LEAST_TORN:
        same = "; all poses look the same way" if np.ptp(np.unwrap(track.poses[:, 2])) < _SAME_YAW else ""
        torn = "whether a mirrored trajectory or yaw counted the other way tears the map"
        reason = f"frame: the trajectory turns in too few windows to show {torn}{same}"
        return Finding(VerdictStatus.PASS, reason, judged=False)
    for reading in _READINGS:
        whole = sum(engine.map(_is_whole, (place(track.poses * reading.signs), settings, estimator), tried))
        if whole >= _WHOLE * len(tried):
            reason = f"{whole} of the {len(tried)} windows that turn the most are whole once this error is undone"
            said = f"{reading.name}: {reading.remedy}"
            return Finding(VerdictStatus.FAIL, f"{reading.name}: {reason}", cause=Cause.MIRROR, explanation=said)
    return Finding(VerdictStatus.PASS, "neither a mirrored trajectory nor yaw counted the other way makes the map whole")


def _measure_turn(sweeps: Sweeps, window: WindowAudit) -> float:
    """Returns the absolute change of the yaw [rad] from the first to the last sweep of a window."""
    begin, end = sweeps.poses[[window.begin, window.end - 1], 2]
    return abs(float(se2.wrap(end - begin)))


def _is_whole(shared: Shared, given: WindowAudit) -> bool:
    """Returns whether a window is whole under the poses of `shared`, crisper than as `given`, and its speed is confirmed."""
    sweeps, _, estimator = shared
    window = audit_window(shared, given.begin)
    if window.torn or window.bend.psi >= given.bend.psi:
        return False
    check = check_speed(shared, (given.begin + given.end) // 2 - 1)
    return check is not None and check.sure and not contradicts(check, find_capture_range(sweeps.revolution_s, estimator))
