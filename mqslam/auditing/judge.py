"""Audits a map: judges its windows, steps, spans and revisits, and combines the findings into a verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, TypeAlias

import gtsam
import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.findings import (
    LEAST_MATCHED,
    find_bias,
    find_delay,
    find_lever,
    find_torn_steps,
    judge_locally,
    judge_pooled,
    judge_revisits,
    judge_spans,
    judge_steps,
    judge_sums,
    judge_windows,
    pick_jumps,
)
from mqslam.auditing.frame import Place, judge_frame, judge_readings
from mqslam.auditing.gyroscope_check import check_gyroscope, judge_gyroscope
from mqslam.auditing.own_test import judge_by
from mqslam.auditing.registration import Shared
from mqslam.auditing.revisits import RevisitAudit, audit_revisits, doubt_interpolated
from mqslam.auditing.sizes import WINDOW
from mqslam.auditing.spans.measured import explain_few_spans, register_spans
from mqslam.auditing.spans.pooled import Pooled, measure_twists, pool, predict_offsets
from mqslam.auditing.spans.sums import SumAudit, audit_sums, find_bends
from mqslam.auditing.spans.torn import SpanAudit, audit_spans
from mqslam.auditing.speeds import (
    CaptureRange,
    SpeedCheck,
    check_speeds,
    contradicts,
    find_capture_range,
    judge_speeds,
)
from mqslam.auditing.steps import StepAudit, audit_steps
from mqslam.auditing.sweeps import Sweeps, place_sweeps
from mqslam.auditing.table import MapTest, apply_tolerance, share_of_false_alarms, sort_tests
from mqslam.auditing.tracks import Jump, find_jumps, judge_cover, judge_doubt, judge_track, mark_interpolated, state_cover
from mqslam.auditing.verdict import Cause, Finding, Verdict, VerdictStatus, verdict_of
from mqslam.auditing.windows.shaking import judge_shaking
from mqslam.auditing.windows.windows import Undecided, WindowAudit, audit_windows, state_p_values
from mqslam.backend.marginals import GraphCovariances, RelativeCovariances
from mqslam.backend.pose_graph import PoseGraph
from mqslam.config import AuditConfig, Config
from mqslam.core import se2
from mqslam.core.engine import Engine
from mqslam.core.scans import Scans
from mqslam.core.sensors import Gyroscope
from mqslam.core.trajectory import Trajectory
from mqslam.execution.progress import Progress
from mqslam.execution.runner import Runner
from mqslam.psi.place import Beam

# Largest number of windows that a run judges in its own map, evenly spread. An audit judges all windows.
_SAMPLED_WINDOWS = 100


Optimum: TypeAlias = tuple[PoseGraph, gtsam.Values]  # a pose graph and its optimised values


@dataclass(frozen=True)
class Audit:
    """The judgement of a map.

    Args:
        windows: windows of the map in the order of time.
        steps: steps of the map in the order of time.
        jumps: the steps at which the map jumps.
        spans: spans of the map in the order of time; empty for a cloud without a trajectory, as are `sums` and `revisits`.
        sums: sums of successive spans, in the order of the time at which they begin.
        pooled: errors of the whole trajectory, estimated from all spans; None for too few spans or without a trajectory.
        revisits: places that the trajectory comes back to.
        tests: the findings of each test, by the name of the test.
        verdict: the verdict that all findings give together.
        capture: the largest errors of a trajectory that windows can measure.
        own: the tests that the user added.
    """

    windows: list[WindowAudit]
    steps: list[StepAudit]
    jumps: list[StepAudit]
    spans: list[SpanAudit]
    sums: list[SumAudit]
    pooled: Pooled | None
    revisits: list[RevisitAudit]
    tests: dict[str, list[Finding]]
    verdict: Verdict
    capture: CaptureRange
    own: Sequence[MapTest] = ()

    def compute_psi_over_best(self) -> float | None:
        """Returns psi of all decided windows divided by their lowest possible psi, at least 1; None if none is decided."""
        decided = [window.bend for window in self.windows if window.undecided is None]
        return _divide(sum(bend.psi for bend in decided), sum(bend.psi_best for bend in decided))

    def compute_psi_over_best_of_passes(self) -> float | None:
        """Returns psi of all sure revisits divided by their lowest possible psi, at least 1; None if none is sure."""
        sure = [one.registration for one in self.revisits if one.sure]
        return _divide(sum(one.psi for one in sure), sum(one.psi_best for one in sure))


class Known(NamedTuple):
    """Knowledge about a trajectory besides its poses.

    Args:
        stated: gives the covariances that the trajectory itself states for one pose relative to another, by the numbers
            of the two sweeps; None if the trajectory states no covariances.
        place: returns the points under other poses, to test whether the trajectory is mirrored; None omits this test.
        sensors: findings from the comparison of the trajectory with other sensors.
        own: further tests of the map, which the user added.
        is_of_run: whether a run made the trajectory, so that its stamps are the stamps of the recording.
        odometry: (M, 3) poses x, y [m], yaw [rad] by odometry at the times of the trajectory's poses; None without odometry.
    """

    stated: RelativeCovariances | None = None
    place: Place | None = None
    sensors: Sequence[Finding] = ()
    own: Sequence[MapTest] = ()
    is_of_run: bool = False
    odometry: se2.Array | None = None


UNKNOWN: Final = Known()
"""Nothing is known about a trajectory besides its poses."""


def _divide(psi: float, best: float) -> float | None:
    """Returns psi divided by the best psi, at least 1 since a search may slightly miss the best; None if `best` is zero."""
    return max(psi / best, 1.0) if best > 0.0 else None


def audit(
    sweeps: Sweeps,
    config: Config,
    engine: Engine,
    progress: Progress,
    sampled: int | None = None,
    known: Known = UNKNOWN,
) -> Audit:
    """Judges a map by all tests, and combines their findings into a verdict.

    Args:
        sweeps: points of the map under the trajectory.
        config: all settings.
        engine: where windows and revisits are judged; the result does not depend on it.
        progress: called as parts of the map are done.
        sampled: largest number of windows to judge, evenly spread; None judges all windows.
        known: knowledge about the trajectory besides its poses, such as covariances and findings of sensors.

    Raises:
        ConfigError: a test that the user added stops with an error, or does not return findings.
    """
    estimator, limits = config.estimator, config.verdict
    settings = apply_tolerance(config.audit, limits)
    shared = sweeps, settings, estimator
    windows = audit_windows(shared, engine, progress, sampled)
    track = sweeps.track
    interpolated = np.zeros(len(sweeps), dtype=np.bool_)  # without a trajectory there is no gap
    if track is not None:
        interpolated = mark_interpolated(track, sweeps.times, sweeps.revolution_s)
    middles = [(w.begin + w.end) // 2 - 1 for w in windows]
    speeds = check_speeds(shared, middles, ~interpolated, engine, progress)
    capture = find_capture_range(sweeps.revolution_s, estimator)
    windows = state_p_values(_decide(windows, speeds, interpolated, capture))
    steps = audit_steps(shared, ~interpolated, share_of_false_alarms(limits), engine, progress)
    jumps = pick_jumps(find_torn_steps(steps, settings, limits), lambda step: step.registration.size_m)
    tests = {
        "trajectory": _judge_trajectory(sweeps, steps, settings, known.odometry),
        "speeds": judge_speeds(speeds, capture, is_of_run=known.is_of_run),
        "windows": judge_windows(windows, len(sweeps), is_of_run=known.is_of_run),
        "steps": [judge_steps(steps, jumps, settings, limits)],
    }
    spans: list[SpanAudit] = []
    sums: list[SumAudit] = []
    pooled: Pooled | None = None
    revisits: list[RevisitAudit] = []
    if track is None:
        tests["revisits"] = [judge_locally(windows)]
    else:
        registrations = register_spans(shared, ~interpolated, engine, progress)
        twists = measure_twists(sweeps)
        pooled = pool(registrations, twists)
        expected = np.zeros(3)  # the parts of the offsets that proven errors of the whole trajectory explain
        if pooled is not None:
            proven = find_bias(pooled, limits), find_lever(pooled, limits), find_delay(pooled, limits)
            expected = predict_offsets(registrations, twists, *proven)
        spans = audit_spans(registrations, expected, sweeps.times, settings, limits)
        sums = audit_sums(spans, sweeps, settings, limits)
        revisits = audit_revisits(shared, limits, engine, progress, known.stated)
        revisits = doubt_interpolated(revisits, interpolated)
        path_m = float(sweeps.travelled[-1])
        few = explain_few_spans(registrations, sweeps)
        tests |= {
            "frame": _judge_frame(shared, windows, known.place, engine),
            "spans": [_set_apart(judge_spans(spans, settings, limits, few), expected)],
            "sums": [_set_apart(judge_sums(sums, path_m, settings, limits), expected)],
            "pooled": [
                judge_pooled(pooled, limits, track.extrinsics, track.time_offset_s, is_of_run=known.is_of_run, few=few)
            ],
            "shaking": [judge_shaking(shared, windows, limits, engine)],
            "revisits": [judge_revisits(revisits, settings, limits, path_m if sums and not find_bends(sums) else None)],
            "sensors": list(known.sensors),
        }
    tests = sort_tests(tests | {test.name: judge_by(test, sweeps, settings) for test in known.own})
    return Audit(windows, steps, jumps, spans, sums, pooled, revisits, tests, verdict_of(tests), capture, known.own)


def audit_trajectory(
    scans: Scans,
    trajectory: Trajectory,
    config: Config,
    beam: Beam,
    runner: Runner,
    optimum: Optimum | None = None,
    gyroscope: Gyroscope | None = None,
    odometry: Trajectory | None = None,
) -> Audit:
    """Judges the map that a run has made; of its windows, only `_SAMPLED_WINDOWS` are judged.

    Args:
        scans: scans of the recording.
        trajectory: poses of the sensor.
        config: all settings.
        beam: the sensor's errors.
        runner: where the map is judged; the result does not depend on it.
        optimum: the optimised pose graph of the trajectory and its values, which give the trajectory's covariances; None
            if these cannot be computed.
        gyroscope: gyroscope whose turns are compared with the trajectory's turns, or None.
        odometry: odometry whose jumps are compared with the trajectory's jumps, or None.

    Raises:
        EstimationError: the trajectory covers fewer than two scans, or these hold no returns.
    """
    sensors = [] if gyroscope is None else [judge_gyroscope(check_gyroscope(gyroscope, scans, trajectory))]
    sweeps, inside = place_sweeps(scans, trajectory, beam)
    stated = None if optimum is None else GraphCovariances(*optimum, inside, sweeps.poses)
    driven = None if odometry is None else odometry.at(trajectory.stamps_us)
    known = Known(stated, sensors=sensors, is_of_run=True, odometry=driven)
    return audit(sweeps, config, runner.engine, runner.progress, _SAMPLED_WINDOWS, known)


def _judge_trajectory(
    sweeps: Sweeps, steps: Sequence[StepAudit], settings: AuditConfig, odometry: se2.Array | None
) -> list[Finding]:
    """Returns findings on gaps, jumps and missing poses of the trajectory; none for a cloud without a trajectory.

    Stamps that jitter look like jumps, too. A jump therefore gets the verdict `fail` only if the scans show it as well.
    """
    track = sweeps.track
    if track is None:
        return []
    own = judge_track(track, sweeps.times, sweeps.revolution_s, settings, odometry)
    if any(
        _shows(step, jump, settings) for jump in find_jumps(track, WINDOW * sweeps.revolution_s, settings) for step in steps
    ):
        own = [replace(one, status=VerdictStatus.FAIL) if one.cause is Cause.JUMP else one for one in own]
    found = [*judge_cover(track), *own, *judge_doubt(sweeps.doubt_m, settings)]
    return found or [state_cover(track)]


def _shows(step: StepAudit, jump: Jump, settings: AuditConfig) -> bool:
    """Returns whether a step lies at a jump of the poses, and its scans show an offset of more than `settings.torn_m`."""
    registration = step.registration
    is_large = registration.size_m > max(settings.torn_m, registration.doubt_m)
    fits = registration.unrivalled and registration.psi_best < registration.psi
    return fits and is_large and jump.t0 <= step.t <= jump.t1 + (jump.t1 - jump.t0)


def _set_apart(finding: Finding, expected: NDArray[np.float64]) -> Finding:
    """Returns a finding on spans; if errors of the whole trajectory were left out, its reason says so.

    Args:
        finding: the finding.
        expected: the parts of the spans' offsets that errors of the whole trajectory explain; all zero if there are none.
    """
    if not finding.judged or not np.any(expected):
        return finding
    return replace(finding, reason=f"apart from the errors of the whole trajectory (test pooled), {finding.reason}")


def _judge_frame(shared: Shared, windows: Sequence[WindowAudit], place: Place | None, engine: Engine) -> list[Finding]:
    """Judges whether a trajectory is in the frame of its finished cloud and, if `place` is given, whether it is mirrored."""
    sweeps = shared[0]
    findings = [judge_frame(sweeps)] if sweeps.is_finished else []
    if place is not None:
        findings.append(judge_readings(shared, windows, place, engine))
    return findings


def _decide(
    windows: Sequence[WindowAudit],
    speeds: Sequence[SpeedCheck | None],
    interpolated: NDArray[np.bool_],
    capture: CaptureRange,
) -> list[WindowAudit]:
    """Returns the windows with their speed checks, each marked as torn, whole or undecided.

    The first rule that holds decides. (1) Most scans lie in a gap of the trajectory: undecided. (2) The scans contradict the
    speed: torn, whatever the inflation. (3) Almost no point is seen twice, even in the best map: undecided. (4) Otherwise:
    as `audit_windows` has judged the inflation.

    Args:
        windows: windows as `audit_windows` returns them.
        speeds: the speed check of each window; None where there is none.
        interpolated: (S,) mask of the sweeps that lie in a gap of the trajectory.
        capture: the largest errors of a trajectory that windows can measure.
    """
    decided = []
    for window, speed in zip(windows, speeds, strict=True):
        is_off = contradicts(speed, capture)
        undecided = None if is_off else window.undecided
        if np.mean(interpolated[window.begin : window.end]) > 0.5:
            undecided = Undecided.GAP
        elif window.bend.matched_best < LEAST_MATCHED and not is_off:
            undecided = Undecided.APART
        torn = (window.torn or is_off) and undecided is None
        decided.append(replace(window, torn=torn, undecided=undecided, speed=speed, by_speed=torn and not window.torn))
    return decided
