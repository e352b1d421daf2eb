"""Speeds that the scans themselves contradict: what lies beyond the capture range of inflation is found by a wide search.

A window's correction is looked for near the trajectory. Beyond a certain distance psi has other minima, in which the window
stays, and its inflation means nothing there. Two successive scans, searched for each other over all plausible speeds, have
no such limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mqslam.auditing.laying import ask_of_single_scans, compute_far_reach, fits_far_better, lay, measure_span
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.verdict import Finding, Share, VerdictStatus
from mqslam.config import AuditConfig, EstimatorConfig, VerdictConfig
from mqslam.core import se2
from mqslam.core.wording import count_of
from mqslam.execution.engine import Engine
from mqslam.execution.progress import Progress


@dataclass(frozen=True, slots=True)
class CaptureRange:
    """How wrong a trajectory may be for the test of its windows to measure it.

    Args:
        window_m: correction over a window up to which it is surely found [m].
        speed_mps: the same as an error of the speed [m/s].
        searched_mps: error of the speed up to which the speed of successive scans is compared [m/s].
    """

    window_m: float
    speed_mps: float
    searched_mps: float


@dataclass(frozen=True, slots=True)
class SpeedCheck:
    """The motion between two successive scans, held against the trajectory's.

    Args:
        error: (3,) what the trajectory's motion lacks, as a mean velocity in the frame of the later scan [m/s, m/s, rad/s].
        sure: whether the two scans hold every direction and fit nowhere else as well; if the error is beyond the capture
            range, not where the trajectory has them either.
    """

    error: se2.Array
    sure: bool

    @property
    def error_mps(self) -> float:
        """Size of the error of the speed [m/s]."""
        return float(np.hypot(self.error[0], self.error[1]))


def find_capture_range(revolution_s: float, settings: AuditConfig, estimator: EstimatorConfig) -> CaptureRange:
    """Returns the capture range of the windows' test.

    The widest search for a window's best map begins with neighbourhoods of `estimator.s_start`: a correction that moves a
    window's ends farther against each other moves some points out of each other's neighbourhood.

    Args:
        revolution_s: usual duration of a scan [s].
        settings: of the audit.
        estimator: settings of the score.
    """
    reach_m = estimator.s_start
    return CaptureRange(reach_m, reach_m / (settings.window * revolution_s), settings.speed_error_mps)


def check_speeds(
    sweeps: Sweeps,
    middles: Sequence[int],
    settings: AuditConfig,
    estimator: EstimatorConfig,
    engine: Engine,
    progress: Progress,
) -> list[SpeedCheck | None]:
    """Compares the motions from given sweeps to the next ones with the trajectory's.

    Args:
        sweeps: points under the trajectory to judge.
        middles: sweeps, each of which has one after it.
        settings: of the audit.
        estimator: settings of the score.
        engine: where the motions are compared; the result does not depend on it.
        progress: called as motions are compared.

    Returns:
        one check per sweep; None where either scan holds too few points.
    """

    def report(number: int, check: SpeedCheck | None) -> None:
        progress("speeds", number, len(middles))

    return engine.map(_check_from, (sweeps, settings, estimator), list(middles), report)


def _check_from(shared: tuple[Sweeps, AuditConfig, EstimatorConfig], begin: int) -> SpeedCheck | None:
    """Compares the motion from a sweep to the next one."""
    sweeps, settings, estimator = shared
    span_s = measure_span(sweeps, begin)
    reach = compute_far_reach(span_s, settings)
    laid = lay(sweeps, (begin, begin + 1), ([begin], [begin + 1]), reach, ask_of_single_scans(settings), estimator)
    if laid is None:
        return None
    check = SpeedCheck(laid.offset / span_s, laid.unrivalled)
    if contradicts(check, find_capture_range(sweeps.revolution_s, settings, estimator)):  # the wide search may lead away
        return replace(check, sure=fits_far_better(laid, settings))
    return check


def contradicts(check: SpeedCheck | None, capture: CaptureRange) -> bool:
    """Returns whether two scans surely moved otherwise than the trajectory says, by more than inflation can measure."""
    return check is not None and check.sure and check.error_mps > capture.speed_mps


def judge_speeds(checks: Sequence[SpeedCheck | None], capture: CaptureRange, limits: VerdictConfig) -> list[Finding]:
    """Returns what the speeds say about a map; nothing where none of them is sure.

    Args:
        checks: of all windows.
        capture: of the windows' test.
        limits: settings of the verdict; speeds have the limits of windows.
    """
    sure = [check for check in checks if check is not None and check.sure]
    if not sure:
        return []
    off = [check for check in sure if contradicts(check, capture)]
    share = Share(len(off), len(sure))
    if not off:
        most = f"{capture.speed_mps:.2g} m/s, the most that windows measure"
        reason = f"none of {count_of(share.total, 'speed')} is off by more than {most}"
        return [Finding(VerdictStatus.PASS, reason)]
    median = float(np.median([check.error_mps for check in off]))
    reason = (
        f"the scans contradict the trajectory's speed at {share.count} of {count_of(share.total, 'place')}, by {median:.1f} "
        f"m/s in the median: corrections beyond {capture.window_m:.2g} m over a window ({capture.speed_mps:.2g} m/s) cannot "
        "be measured, and inflation means nothing there"
    )
    if share.is_above(limits.windows_fail, limits):
        return [Finding(VerdictStatus.FAIL, reason)]
    return [Finding(VerdictStatus.WARN if share.is_above(limits.windows_warn, limits) else VerdictStatus.PASS, reason)]
