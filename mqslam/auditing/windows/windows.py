"""Judges the windows of a map: the map of each window is compared with the best map of the same points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.stats import chi2

from mqslam.auditing.registration import Shared
from mqslam.auditing.sizes import TORN_INFLATION, WINDOW
from mqslam.auditing.speeds import SpeedCheck
from mqslam.auditing.verdict import Share
from mqslam.auditing.windows.inflation import Bend, fit_bend
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.statistics import correct_for_places, pick_evenly
from mqslam.execution.progress import Progress, count_items
from mqslam.mapping.measures import Measures, compute_measures, locate_sensors


class Undecided(StrEnum):
    """The reason why a window counts as neither torn nor whole."""

    GAP = "its motion is interpolated across a gap of the trajectory"
    SPARSE = "its error may come from interpolation alone, since poses are too sparse for a turn"
    APART = "almost no point is seen twice, even in the best map"


@dataclass(frozen=True, slots=True)
class WindowAudit:
    """The judgement of one window.

    Args:
        begin, end: the window consists of the sweeps begin <= k < end.
        t0, t1: times at which the window begins and ends [s] since the recording's start.
        pose: (3,) pose x, y [m], yaw [rad] of the sensor at the window's middle, in the map's frame.
        bend: the correction that makes the map of the window its best map.
        measures: published measures of map quality for the same points.
        torn: whether the correction is larger than its covariance and interpolation explain and larger than the settings
            tolerate, or whether the scans contradict the speed.
        undecided: why the window counts as neither torn nor whole; None if it is decided.
        speed: check of the speed between the two middle scans; None if the speed was not checked.
        p_value: probability that a good map has an inflation this large in any window, if the covariance of the correction
            is right; NaN for an undecided window.
        by_speed: whether the window is torn only because the scans contradict the speed.
    """

    begin: int
    end: int
    t0: float
    t1: float
    pose: se2.Array
    bend: Bend
    measures: Measures
    torn: bool
    undecided: Undecided | None = None
    speed: SpeedCheck | None = None
    p_value: float = np.nan
    by_speed: bool = False


def audit_windows(shared: Shared, engine: Engine, progress: Progress, sampled: int | None = None) -> list[WindowAudit]:
    """Judges the windows of a map in the order of time; windows without a point are left out.

    Args:
        shared: points under the trajectory to judge, settings of the audit and settings of the score.
        engine: where the windows are judged; the result does not depend on it.
        progress: called as windows are done.
        sampled: largest number of windows to judge, evenly spread; None judges all windows.
    """
    sweeps = shared[0]
    begins = list(range(0, len(sweeps) - WINDOW + 1, WINDOW))
    if begins and begins[-1] + WINDOW < len(sweeps):
        begins.append(len(sweeps) - WINDOW)  # the last window overlaps the window before it: every sweep is judged
    begins = [begin for begin in begins if sweeps.begins[begin + WINDOW] > sweeps.begins[begin]]
    if sampled is not None:
        begins = [begins[k] for k in pick_evenly(len(begins), sampled).tolist()]
    return engine.map(audit_window, shared, begins, count_items(progress, "audit", len(begins)))


def audit_window(shared: Shared, begin: int) -> WindowAudit:
    """Judges the window that begins with the sweep `begin` by the correction that makes its map the best map."""
    sweeps, settings, estimator = shared
    end = begin + WINDOW
    span = sweeps.span(begin, end)
    points, turns = sweeps.points[span].copy(), sweeps.turns[span].copy()
    bend = fit_bend(sweeps, begin, end, estimator)
    measures = compute_measures(
        points,
        np.searchsorted(sweeps.numbers[begin:end], turns, side="right"),
        locate_sensors(turns, sweeps.numbers, sweeps.poses),
        settings,
    )
    explained = bend.size_m <= sweeps.doubt([range(begin, end)])
    is_bent = bend.inflation > TORN_INFLATION and bend.size_m > settings.bend_m
    return WindowAudit(
        begin=begin,
        end=end,
        t0=float(sweeps.times[begin]),
        t1=float(sweeps.times[end - 1] + sweeps.revolution_s),
        pose=sweeps.poses[(begin + end) // 2],
        bend=bend,
        measures=measures,
        torn=bool(is_bent) and not explained,
        undecided=Undecided.SPARSE if is_bent and explained else None,
    )


def share_torn(windows: Sequence[WindowAudit]) -> Share:
    """Returns the share of torn windows among the decided windows."""
    decided = [window for window in windows if window.undecided is None]
    return Share(sum(window.torn for window in decided), len(decided))


def state_p_values(windows: Sequence[WindowAudit]) -> list[WindowAudit]:
    """Returns the windows with their p-values, which are corrected for the number of decided windows."""
    inflations = np.array([np.nan if window.undecided else window.bend.inflation for window in windows])
    p_values = correct_for_places(np.asarray(chi2.sf(inflations, 3)))
    return [replace(window, p_value=p) for window, p in zip(windows, p_values.tolist(), strict=True)]
