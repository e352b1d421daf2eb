"""Finds shaking: poses that jump to and fro from scan to scan. Smoothing such poses makes the map crisper.

Other tests do not see shaking: the correction of a window is one twist, and registrations of several scans average the
shaking out. Where a trajectory is right, smoothing removes true motion and blurs the map. Smoothing makes the map crisper
only where every pose has an error of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wilcoxon

from mqslam.auditing.registration import Shared
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.table import share_of_false_alarms
from mqslam.auditing.verdict import Cause, Finding, VerdictStatus
from mqslam.auditing.windows.inflation import count_in_sweeps
from mqslam.auditing.windows.windows import WindowAudit
from mqslam.config import EstimatorConfig, VerdictConfig
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.psi.minimiser import final_scale
from mqslam.psi.place import PointSet
from mqslam.psi.score import evaluate

_SIDE: Final = 3  # a parabola is fitted to a pose and this many poses on either side: 1.5 s at four scans per second

_Shared = tuple[Sweeps, se2.Array, EstimatorConfig]  # a map, its smoothed poses (S, 3), and the settings of the score


def judge_shaking(shared: Shared, windows: Sequence[WindowAudit], limits: VerdictConfig, engine: Engine) -> Finding:
    """Judges whether the poses of a map jump to and fro.

    The verdict is `warn` if smoother poses make the map crisper by more than chance explains, and are off the given poses by
    more than `settings.bend_m` in the median.

    Args:
        shared: points under the trajectory to judge, whose `track` is not None, settings of the audit and settings of the
            score.
        windows: windows in which the map is compared with the map under smoothed poses; undecided windows are left out.
        limits: settings of the verdict.
        engine: where the windows are scored; the result does not depend on it.
    """
    sweeps, settings, estimator = shared
    smoothed = smooth_poses(sweeps)
    spans = [(w.begin, w.end) for w in windows if w.undecided is None and w.end < len(sweeps)]
    spans = [(begin, end) for begin, end in spans if np.isfinite(smoothed[begin : end + 1]).all()]
    if 0.5 ** len(spans) >= share_of_false_alarms(limits):  # chance would explain even that smoothing helps in all windows
        hidden = f"noise of up to {settings.bend_m:g} m per scan could hide"
        reason = f"noise of the poses: too few windows could show it, so that {hidden}"
        return Finding(VerdictStatus.PASS, reason, judged=False)
    rises = np.array(engine.map(_measure_rise, (sweeps, smoothed, estimator), spans))
    p_value = float(wilcoxon(rises, alternative="greater").pvalue) if rises.any() else 1.0
    off = se2.between(sweeps.poses, smoothed)
    off_m = float(np.nanmedian(np.hypot(off[:, 0], off[:, 1])))
    if p_value >= share_of_false_alarms(limits):
        return Finding(VerdictStatus.PASS, "smoother poses do not surely make the map crisper", p_value=p_value)
    if off_m <= settings.bend_m:
        reason = f"smoother poses make the map crisper, but lie only {off_m:.2f} m off the given ones in the median"
        return Finding(VerdictStatus.PASS, reason, p_value=p_value)
    explanation = f"every pose errs on its own, by {off_m:.2f} m in the median: the trajectory is noisy"
    where = f"in {np.count_nonzero(rises > 0.0)} of {len(rises)} windows the map is crisper once the poses are smoothed"
    reason = f"{where}: the poses jump to and fro by {off_m:.2f} m in the median"
    return Finding(VerdictStatus.WARN, reason, p_value=p_value, cause=Cause.SHAKING, explanation=explanation)


def smooth_poses(sweeps: Sweeps) -> se2.Array:
    """Returns the poses (S, 3) of sweeps, each from a parabola fitted to the poses around it; NaN near gaps and ends."""
    poses = sweeps.poses.copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    smoothed = np.full_like(poses, np.nan)
    for k in range(_SIDE, len(poses) - _SIDE):
        around = slice(k - _SIDE, k + _SIDE + 1)
        turns = sweeps.numbers[around] - sweeps.numbers[k]
        if turns[-1] - turns[0] < 2.0 * _SIDE + 0.5:  # else a sweep is missing
            times = sweeps.times[around] - sweeps.times[k]
            smoothed[k] = np.linalg.lstsq(np.vander(times, 3), poses[around], rcond=None)[0][2]
    return smoothed


def _measure_rise(shared: _Shared, window: tuple[int, int]) -> float:
    """Returns by how much smoothed poses lower psi per point in a window (begin, end) of sweeps begin <= k < end."""
    sweeps, smoothed, estimator = shared
    begin, end = window
    points = sweeps.local(range(begin, end), np.zeros(3))
    if len(points) == 0:
        return 0.0
    moved = replace(points, points=_move(sweeps, smoothed, begin, end, points))
    scale, kernel = final_scale(estimator), count_in_sweeps(estimator, sweeps.revolution_s)
    given, smoother = (evaluate(one, None, scale, kernel).psi for one in (points, moved))
    return (given - smoother) / len(points)


def _move(sweeps: Sweeps, smoothed: se2.Array, begin: int, end: int, points: PointSet) -> NDArray[np.float64]:
    """Returns the points (N, 2) [m] of a window under smoothed poses (S, 3), in the map's frame.

    The window consists of the sweeps begin <= k < end. `points` holds its N points in the map's frame under the given poses,
    with times counted in sweeps.
    """
    track = sweeps.track
    assert track is not None  # a cloud without a trajectory has no poses to judge
    sweep = np.searchsorted(sweeps.numbers, points.times, side="right") - 1
    seconds = sweeps.times[sweep] + (points.times - sweeps.numbers[sweep]) * sweeps.revolution_s
    seen_from = se2.interpolate(track.times, track.poses, seconds)
    seen = se2.between(seen_from, np.column_stack([points.points, np.zeros(len(points))]))
    knots = slice(begin, end + 1)
    return np.asarray(se2.compose(se2.interpolate(sweeps.times[knots], smoothed[knots], seconds), seen)[:, :2])
