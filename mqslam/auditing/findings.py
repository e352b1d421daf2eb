"""Converts the measurements of the tests of a map into findings, each with a verdict and its reason in words."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.auditing.revisits import RevisitAudit, judge_honesty
from mqslam.auditing.sizes import STEP_FEWEST, STEP_SCANS, WINDOW
from mqslam.auditing.spans.pooled import Pooled
from mqslam.auditing.spans.robust import Estimate
from mqslam.auditing.spans.sums import LENGTHS_M, SumAudit, find_bends
from mqslam.auditing.spans.torn import SpanAudit
from mqslam.auditing.steps import StepAudit
from mqslam.auditing.table import (
    DELAY_WARN_S,
    LEVER_WARN,
    SCALE_WARN,
    TURN_WARN,
    share_of_false_alarms,
    tolerate_row,
    tolerate_span,
    tolerate_step,
    tolerate_sum,
    tolerate_window,
)
from mqslam.auditing.verdict import WINDOWS_FAIL, WINDOWS_WARN, Cause, Finding, Share, VerdictStatus
from mqslam.auditing.windows.windows import Undecided, WindowAudit, share_torn
from mqslam.config import AuditConfig, VerdictConfig
from mqslam.core import se2
from mqslam.core.statistics import correct_for_places, find_smallest
from mqslam.core.wording import count_of, describe_times, is_or_are, join_words, left_or_right
from mqslam.errors import Remedy

# A map with a larger share of torn revisits than this gets the verdict `warn`. A few torn revisits may pair two places that
# only look alike.
_REVISITS_WARN = 0.02
# A map with a larger share of torn revisits than this gets the verdict `fail`: it drifts as a whole.
_REVISITS_FAIL = 0.1
# Fewest successive revisits that must agree on an offset to show that one pass lies beside the other.
_ROW = 3
# A reason names at most this many further places one by one, so that the reason stays readable.
_NAMED: Final = 3
_FEW: Final = "too few spans could be measured"
# If fewer of a window's points than this share are seen twice, its scans do not overlap and psi cannot judge the window.
LEAST_MATCHED = 0.15
# A map gets the verdict `fail` if the scans do not overlap in more than this share of its windows.
_APART_FAIL = 0.5


def judge_windows(windows: Sequence[WindowAudit], scans: int, *, is_of_run: bool = False) -> list[Finding]:
    """Judges a map by its windows: by how many are torn, and in how many almost no point is seen twice.

    Args:
        windows: the windows that were judged, decided or not.
        scans: number of scans of the map.
        is_of_run: whether a run made the trajectory, so that the trajectory surely belongs to this recording.

    Returns:
        A finding on the share of torn windows, `not judged` if windows are missing or too few. It may be followed by (1) a
        `warn`: in too many windows almost no point is seen twice even after psi has corrected the motion through the window,
        (2) a `fail`: under the given poses, without this correction, almost no point is seen twice in most windows.
    """
    if not windows:
        reason = f"no window of {WINDOW} scans could be checked, so that nothing shows how good the map is"
        if scans < WINDOW:
            reason = f"{count_of(scans, 'scan')} {is_or_are(scans)} too few to judge a map by: a window takes {WINDOW}"
        return [Finding(VerdictStatus.NOT_JUDGED, reason)]
    torn = share_torn(windows)
    status = torn.judge(WINDOWS_WARN, WINDOWS_FAIL)
    reason = f"{torn.count} of {count_of(torn.total, 'window')} {is_or_are(torn.count)} torn"
    if not torn.total:
        reason = f"none of {count_of(len(windows), 'window')} could be decided"
    elif status is VerdictStatus.NOT_JUDGED:
        reason += f", too few to judge the map by: the share of torn windows may be {torn.describe_range()}"
    elif status is VerdictStatus.PASS and torn.count:
        reason += f", which is no evidence that more than {WINDOWS_WARN:.0%} are torn"
    if 0 < torn.total < len(windows):
        reason += f", {len(windows) - torn.total} undecided"
    p_value = find_smallest(window.p_value for window in windows)
    reason += _describe_worst([window for window in windows if window.torn])
    findings = [Finding(status, reason, p_value=p_value)]
    blind = Share(sum(w.undecided is Undecided.APART for w in windows), len(windows))
    if blind.is_above(WINDOWS_FAIL):
        reason = f"{blind.count} of {count_of(blind.total, 'window')} {is_or_are(blind.count)} undecided: {Undecided.APART}"
        findings.append(Finding(VerdictStatus.WARN, reason))
    known = [w for w in windows if w.undecided is not Undecided.GAP]  # in a gap all poses are interpolated
    apart = Share(sum(w.bend.matched < LEAST_MATCHED for w in known), len(known))
    if apart.is_above(_APART_FAIL):
        matched = float(np.median([w.bend.matched for w in known]))
        reason = f"only {matched:.0%} of the points are seen twice"
        strange = "" if is_of_run else "belong to another recording or "
        explanation = f"the poses {strange}are far off, since nothing overlaps"
        findings.append(Finding(VerdictStatus.FAIL, reason, cause=Cause.RECORDING, explanation=explanation))
    return findings


def judge_steps(
    steps: Sequence[StepAudit], jumps: Sequence[StepAudit], settings: AuditConfig, limits: VerdictConfig
) -> Finding:
    """Judges a map by its steps: `warn` if the trajectory jumps or a few scans alone are displaced.

    The verdict is `fail` if the largest jump moves points by more than `settings.torn_m`.

    Args:
        steps: all steps that were registered.
        jumps: the steps at which the map jumps, as `pick_jumps` returns them.
        settings: settings of the audit, with the tolerances of jumps.
        limits: settings of the verdict.
    """
    p_value = find_smallest(step.p_value for step in steps if step.judged)
    if jumps:
        worst = max(jumps, key=lambda step: step.registration.size_m)
        others = _list_places("and at", [jump.t for jump in jumps if jump is not worst])
        reason = f"the map {_describe_jump(worst)} at {worst.t:.1f} s{others}"
        status = VerdictStatus.FAIL if worst.registration.size_m > settings.torn_m else VerdictStatus.WARN
        explanation = f"the trajectory {_describe_jump(worst)} in a single step at {worst.t:.1f} s"
        cause = Cause.JUMP
        if len(jumps) > 1:  # bends and noise cause several jumps, too
            explanation = f"the map jumps at {len(jumps)} places, the farthest at {worst.t:.1f} s"
            cause = Cause.JUMPS
        return Finding(status, reason, p_value=p_value, cause=cause, explanation=explanation)
    bumps = [step for step in steps if _is_bump(step, settings, limits)]
    if bumps:
        worst = max(bumps, key=lambda step: step.registration.size_m)
        size_m = worst.registration.size_m
        reason = f"a few scans around {worst.t:.1f} s are {size_m:.2f} m off the scans before and after them"
        return Finding(VerdictStatus.WARN, reason, p_value=p_value, cause=Cause.JUMP, explanation=reason)
    shown = [step for step in steps if step.judged and step.registration.doubt_m <= settings.jump_m]
    if len(shown) < STEP_FEWEST:
        reason = f"jumps: too few steps could be measured, so that a jump of up to {settings.torn_m:g} m could hide"
        return Finding(VerdictStatus.PASS, reason, judged=False)
    tolerated_m, _ = tolerate_step(settings)
    reason = f"no jump of more than {tolerated_m:g} m at any of {count_of(len(shown), 'step')}"
    return Finding(VerdictStatus.PASS, reason, p_value=find_smallest(step.p_value for step in shown))


def _list_places(said: str, times: Sequence[float]) -> str:
    """Returns the end of a sentence: a comma, the words `said`, the first `_NAMED` times [s], and how many more there are.

    Without times, the text is empty.
    """
    named = [f"{t:.1f} s" for t in times[:_NAMED]]
    if len(times) > _NAMED:
        named.append(count_of(len(times) - _NAMED, "more place"))
    return f", {said} {join_words(named)}" if named else ""


def _describe_jump(step: StepAudit) -> str:
    """Returns the size of a jump in words; if the points move mainly by a rotation, the text states its angle, too."""
    offset, size_m = step.registration.offset, step.registration.size_m
    moved_m = float(np.hypot(offset[0], offset[1]))
    if moved_m > 0.5 * size_m:
        return f"jumps by {size_m:.2f} m"
    turn = f"turns by {np.degrees(abs(offset[2])):.1f} deg"
    return f"{turn} and jumps by {moved_m:.2f} m, which together move points by {size_m:.2f} m,"


def _is_bump(step: StepAudit, settings: AuditConfig, limits: VerdictConfig) -> bool:
    """Returns whether a few scans at a step are displaced while the map on both sides of them is not.

    Their offset must be larger than chance explains, than 2 `settings.jump_m`, and than errors of interpolation.
    """
    is_large = step.registration.size_m > max(2.0 * settings.jump_m, step.registration.doubt_m)
    return is_large and not step.lasts and _fits_better_moved(step, limits)


def _fits_better_moved(step: StepAudit, limits: VerdictConfig) -> bool:
    """Returns whether a step's offset is larger than chance explains, and its sides fit better with the offset corrected.

    The sides must also fit about as well at no other offset.
    """
    return (
        step.judged and step.p_value < share_of_false_alarms(limits) and step.registration.psi_best < step.registration.psi
    )


def find_torn_steps(steps: Sequence[StepAudit], settings: AuditConfig, limits: VerdictConfig) -> list[StepAudit]:
    """Returns the steps that show a jump of the map; steps that share scans may show the same jump.

    At a jump, (1) the offset is larger than chance explains and larger than `settings.jump_m`, (2) the two sides fit better
    with the offset corrected, and (3) they fit nowhere else about as well: scans with few points in common, such as scans of
    a lidar that turns on the spot, fit at many places. A jump below `settings.torn_m` must also last: otherwise only a few
    scans are displaced. Where poses are too sparse to follow the turns, any jump must last and exceed `doubt_m`.

    Args:
        steps: the steps in the order of time.
        settings: settings of the audit.
        limits: settings of the verdict.
    """

    def is_off(step: StepAudit) -> bool:
        registration = step.registration
        if registration.doubt_m > settings.jump_m:  # an error of interpolation does not last: it ends at the next pose
            is_large = step.lasts and registration.size_m > registration.doubt_m
        else:
            is_large = registration.size_m > (settings.jump_m if step.lasts else settings.torn_m)
        return is_large and _fits_better_moved(step, limits)

    return [step for step in steps if is_off(step)]


def pick_jumps(torn: Sequence[StepAudit], rank: Callable[[StepAudit], float]) -> list[StepAudit]:
    """Returns the step of the highest rank for each jump.

    Args:
        torn: the steps that show jumps, in the order of time. Those that share scans show the same jump.
        rank: returns the rank of a step.
    """
    jumps: list[StepAudit] = []
    for step in torn:
        if jumps and step.registration.later - jumps[-1].registration.later <= 2 * STEP_SCANS:  # the two steps share scans
            jumps[-1] = max(jumps[-1], step, key=rank)
        else:
            jumps.append(step)
    return jumps


def judge_pooled(
    pooled: Pooled | None,
    limits: VerdictConfig,
    extrinsics: se2.Array | None = None,
    time_offset_s: float | None = None,
    *,
    is_of_run: bool = False,
    few: str = _FEW,
) -> Finding:
    """Judges errors of the whole map that no single place shows: wrong scale, mount or stamps, and drift of the yaw.

    A wrong scale of the trajectory and a wrong scale of the ranges look alike: the map only shows that the two disagree.

    Args:
        pooled: errors of the whole trajectory, estimated from all spans; None if there are too few spans.
        limits: settings of the verdict.
        extrinsics: (3,) pose x, y [m], yaw [rad] of the sensor in the frame whose motion the given trajectory describes,
            such as the vehicle's frame; None if the user cannot choose the pose.
        time_offset_s: time that was added to the stamps of the given trajectory [s]; None if the user cannot choose it.
        is_of_run: whether a run made the trajectory, so that its stamps are the stamps of the recording.
        few: why there are too few spans, in words; used only if `pooled` is None.
    """
    if pooled is None:
        reason = (
            f"scale, mount and stamps: {few}, so that a wrong scale could hide unless odometry "
            "contradicts it, and wrong extrinsics or late stamps may tear windows but are not recognised as the cause"
        )
        return Finding(VerdictStatus.PASS, reason, judged=False)
    bias = find_bias(pooled, limits)
    biases = np.flatnonzero(bias).tolist()
    described = [_DESCRIBE_BIAS[axis](float(pooled.bias.value[axis]), float(pooled.bias.sigma[axis])) for axis in biases]
    lever = find_lever(pooled, limits)
    delay = find_delay(pooled, limits)
    of_lever = np.empty(0) if pooled.lever is None else pooled.lever.p_value
    p_value = find_smallest(correct_for_places(np.concatenate([pooled.bias.p_value, pooled.delay.p_value, of_lever])))
    reasons = [f"all along the drive {' and '.join(described)}"] if described else []
    if lever is not None:
        reasons.append(_describe_lever(lever))
    if delay is not None:
        reasons.append(_describe_delay(delay, is_of_run=is_of_run))
    if not reasons:
        reason = "scale (against the sensor's own ranges), direction of travel and yaw rate fit what the sensor sees"
        return Finding(VerdictStatus.PASS, reason, p_value=p_value)
    cause = Cause.STAMPS if delay is not None else Cause.MOUNT if lever is not None or _SIDE in biases else Cause.SCALE
    if cause is Cause.SCALE and biases == [_YAW]:
        cause = Cause.DRIFT
    mends_mount = mends_stamps = ""
    if (_SIDE in biases or lever is not None) and extrinsics is not None:
        turned = float(-bias[_SIDE])
        mends_mount = f"; {Remedy.GIVE_EXTRINSICS} {_name_extrinsics(extrinsics, turned, lever)}"
    if delay is not None and time_offset_s is not None:
        mends_stamps = f"; {Remedy.GIVE_TIME_OFFSET} {time_offset_s - delay.value[0]:z.3f}"
    explanation = f"{reasons[-1]}{mends_stamps}" if delay is not None else f"{' and '.join(reasons)}{mends_mount}"
    reason = f"{', and '.join(reasons)}{mends_mount}{mends_stamps}"
    return Finding(VerdictStatus.WARN, reason, p_value=p_value, cause=cause, explanation=explanation)


def _are_proven(estimate: Estimate, tolerated: float | tuple[float, ...], limits: VerdictConfig) -> NDArray[np.bool_]:
    """Returns a mask (Q,) of the parameters of an estimate that are larger than chance explains and than `tolerated`."""
    return (np.abs(estimate.value) > tolerated) & (estimate.p_value < share_of_false_alarms(limits))


def find_lever(pooled: Pooled, limits: VerdictConfig) -> Estimate | None:
    """Returns the lever arm of the sensor; None if unknown, or if it is tolerated or explained by chance on both axes."""
    lever = pooled.lever
    return lever if lever is not None and _are_proven(lever, LEVER_WARN, limits).any() else None


def find_delay(pooled: Pooled, limits: VerdictConfig) -> Estimate | None:
    """Returns the delay of the trajectory's stamps that a map shows; None if it is tolerated or explained by chance."""
    return pooled.delay if _are_proven(pooled.delay, DELAY_WARN_S, limits).any() else None


def _name_extrinsics(given: se2.Array, turned: float, lever: Estimate | None) -> str:
    """Returns corrected extrinsics as text: x, y [m], yaw [degrees], with commas between them.

    Args:
        given: (3,) extrinsics x, y [m], yaw [rad] to be corrected.
        turned: correction of the yaw [rad].
        lever: correction of x and y [m] in the frame of the sensor; None for no correction.
    """
    if lever is None:
        return f"{given[0]:zg},{given[1]:zg},{np.degrees(given[2] + turned):z.2f}"
    x, y, yaw = se2.compose(given, [*lever.value, turned])
    return f"{x:z.2f},{y:z.2f},{np.degrees(yaw):z.2f}"


def find_bias(pooled: Pooled, limits: VerdictConfig) -> NDArray[np.float64]:
    """Returns the values (3,) of `pooled.bias` [m/m, m/m, rad/m]; 0 for a value that is tolerated or explained by chance."""
    proven = _are_proven(pooled.bias, (SCALE_WARN, SCALE_WARN, TURN_WARN), limits)
    return np.where(proven, pooled.bias.value, 0.0)


def _describe_scale(bias: float, sigma: float) -> str:
    longer = "short" if bias > 0.0 else "long"
    share = f"{abs(bias):.3%} (± {sigma:.3%})"
    return f"the trajectory is {share} too {longer} for the sensor's ranges: the scale of one of the two is wrong"


def _describe_direction(bias: float, sigma: float) -> str:
    turn = f"{np.degrees(abs(bias)):.2f} degrees (± {np.degrees(sigma):.2f})"
    farther = f"the sensor moves {turn} farther to the {left_or_right(bias)} than the trajectory says"
    return f"{farther}: wheels slip sideways, or the sensor's mount is turned by this angle"


def _describe_turn(bias: float, sigma: float) -> str:
    turn = f"{100.0 * np.degrees(abs(bias)):.2f} degrees (± {100.0 * np.degrees(sigma):.2f})"
    return f"the yaw drifts by {turn} to the {left_or_right(-bias)} per 100 m"


def _describe_lever(lever: Estimate) -> str:
    ahead, left = lever.value
    parts = [(abs(ahead), "ahead" if ahead > 0.0 else "behind"), (abs(left), f"to the {left_or_right(left)}")]
    places = " and ".join(f"{size:.2f} m {side}" for size, side in parts if size > 0.1 * np.hypot(ahead, left))
    sigma = f"(± {np.max(lever.sigma):.2f})"
    return f"in turns the sensor moves as if it sat {places} {sigma} of where the trajectory has it"


def _describe_delay(delay: Estimate, *, is_of_run: bool) -> str:
    late_s = float(delay.value[0])
    size = f"{abs(late_s):.3f} s (± {delay.sigma[0]:.3f})"
    if is_of_run:
        return f"the motions of the front end are {size} {'behind' if late_s > 0.0 else 'ahead of'} the scans' motions"
    return f"the stamps of the trajectory are {size} {'late' if late_s > 0.0 else 'early'}"


_DESCRIBE_BIAS: Final = (_describe_scale, _describe_direction, _describe_turn)  # for the axes forward, left and yaw
_SIDE, _YAW = 1, 2  # indices of the biases to the side and in yaw


def judge_spans(spans: Sequence[SpanAudit], settings: AuditConfig, limits: VerdictConfig, few: str = "") -> Finding:
    """Judges a map by its spans: `warn` if any is torn, `fail` if the share of torn spans is surely above `WINDOWS_FAIL`.

    Args:
        spans: spans of the map; those without a p-value are left out.
        settings: settings of the audit, with the tolerances.
        limits: settings of the verdict.
        few: why there are too few spans, in words; used only if no span has a p-value. "" gives a general reason.
    """
    tolerated_m, _ = tolerate_span(settings)
    judged = [span for span in spans if np.isfinite(span.p_value)]
    if not judged:
        most_m, _ = tolerate_window(settings)
        hidden = f"{most_m:g} m of error in each window of {WINDOW} scans could hide"
        reason = f"stretches of path: {few or _FEW}, so that {hidden}"
        return Finding(VerdictStatus.PASS, reason, judged=False)
    p_value = find_smallest(span.p_value for span in judged)
    usual_m = float(np.median([span.registration.path_m for span in judged]))
    all_spans = f"{count_of(len(judged), 'span')} of {usual_m:.0f} m of path"
    torn = [span for span in judged if span.torn]
    if not torn:
        off = sum(span.p_value < share_of_false_alarms(limits) for span in judged)
        reason = f"none of {all_spans} is off by more than chance explains"
        if off:
            each = f"more than chance explains, each by less than the {tolerated_m:.2g} m that is tolerated"
            reason = f"{off} of {all_spans} {is_or_are(off)} off by {each}"
        return Finding(VerdictStatus.PASS, reason, p_value=p_value)
    worst = max(torn, key=lambda span: span.size_m)
    reason = f"{len(torn)} of {all_spans} {is_or_are(len(torn))} off, the worst {_describe_span(worst)}"
    fails = Share(len(torn), len(judged)).is_above(WINDOWS_FAIL)
    is_stretched = abs(worst.forward_m) > np.sqrt(0.5) * worst.size_m
    explanation = f"the trajectory is {'stretched' if is_stretched else 'bent'}: {reason}"
    status = VerdictStatus.FAIL if fails else VerdictStatus.WARN
    return Finding(status, reason, p_value=p_value, cause=Cause.DRIFT, explanation=explanation)


def _describe_worst(torn: Sequence[WindowAudit]) -> str:
    """Returns words on torn windows: where the largest correction is, and how many windows are torn only by their speed.

    Without torn windows, the text is empty.
    """
    by_speed = sum(window.by_speed for window in torn)
    bent = max((window for window in torn if not window.by_speed), key=lambda window: window.bend.size_m, default=None)
    worst = "" if bent is None else f", the worst by {bent.bend.size_m:.2f} m {describe_times(bent.t0, bent.t1)}"
    if by_speed:
        worst += f", and {by_speed} {is_or_are(by_speed)} torn only because the scans contradict the speed there"
    return worst


def _describe_span(span: SpanAudit) -> str:
    """Returns in words how far the end of a span is off, in which direction or by which angle, and the time of the span."""
    where = describe_times(span.t0, span.t1)
    if span.distance_m < np.sqrt(0.5) * span.size_m:
        turn = f"{np.degrees(abs(span.offset[2])):.1f} deg to the {left_or_right(-span.offset[2])}"
        return f"turned by {turn} {where}, which moves points by {span.size_m:.2f} m"
    if abs(span.forward_m) < np.sqrt(0.5) * span.distance_m:
        return f"by {span.distance_m:.2f} m to the side {where}"
    return f"{abs(span.forward_m):.2f} m too {'short' if span.forward_m > 0.0 else 'long'} {where}"


def judge_sums(sums: Sequence[SumAudit], path_m: float, settings: AuditConfig, limits: VerdictConfig) -> Finding:
    """Judges a map by sums of spans: `warn` if any is torn, `fail` if torn sums cover more of the path than `WINDOWS_FAIL`.

    Args:
        sums: sums of successive spans.
        path_m: length of the path [m].
        settings: settings of the audit, with the tolerances.
        limits: settings of the verdict.
    """
    if not sums:
        each_m, _ = tolerate_span(settings)
        reason = f"bends: too few spans follow each other, so that a bend of up to {each_m:.2g} m in each span could hide"
        return Finding(VerdictStatus.PASS, reason, judged=False)
    tolerated_m, tolerated_rad = tolerate_sum(settings)
    p_value = find_smallest(one.p_value for one in sums)
    bends = find_bends(sums)
    if not bends:
        lengths = f"{min(one.path_m for one in sums):.0f} to {max(one.path_m for one in sums):.0f} m"
        most = f"more than {tolerated_m:.2g} m or {np.degrees(tolerated_rad):.2g} deg"
        reason = f"no stretch of {lengths} is off by {most}"
        off = sum(one.p_value < share_of_false_alarms(limits) for one in sums)
        if off:
            some = f"{off} of {len(sums)} stretches of {lengths} {is_or_are(off)}"
            reason = f"{some} off by more than chance explains, none by {most}"
        return Finding(VerdictStatus.PASS, reason, p_value=p_value)
    worst = min(bends, key=lambda one: one.p_value)
    others = _list_places("and is bent from", [one.t0 for one in bends if one is not worst])
    fails = sum(one.path_m for one in bends) > WINDOWS_FAIL * path_m
    status = VerdictStatus.FAIL if fails else VerdictStatus.WARN
    reason = f"the trajectory {_describe_sum(worst, tolerated_rad)}{others}"
    return Finding(status, reason, p_value=p_value, cause=Cause.DRIFT, explanation=reason)


def _describe_sum(one: SumAudit, tolerated_rad: float) -> str:
    """Returns in words by how much and when a sum of spans is off, with its error of yaw if above `tolerated_rad` [rad]."""
    where = f"over {one.path_m:.0f} m {describe_times(one.t0, one.t1)}"
    if abs(one.offset[2]) > tolerated_rad:
        turn = f"{np.degrees(abs(one.offset[2])):.1f} deg (± {np.degrees(np.sqrt(one.covariance[2, 2])):.1f})"
        side = left_or_right(-one.offset[2])
        return f"turns by {turn} too far to the {side} {where}, whose end is off by {one.distance_m:.2f} m"
    return f"is off by {one.distance_m:.2f} m {where}"


def judge_locally(windows: Sequence[WindowAudit]) -> Finding:
    """Returns the finding `not judged` on a cloud without a trajectory: even a crisp cloud does not show a drift."""
    reason = "drift and revisits cannot be judged without the cloud's trajectory"
    torn = share_torn(windows)
    if torn.total and not torn.count:
        reason = f"the cloud's {count_of(torn.total, 'window')} {is_or_are(torn.total)} crisp, but {reason}"
    return Finding(VerdictStatus.NOT_JUDGED, reason)


def judge_revisits(
    revisits: Sequence[RevisitAudit], settings: AuditConfig, limits: VerdictConfig, path_m: float | None = None
) -> Finding:
    """Judges a map by its revisits. A map without sure revisits passes, since many drives come back to no place.

    Torn revisits give `warn` or `fail`, unless they are too few to show a drift. A series of revisits that agree on an
    offset, or many excused revisits, only give `warn`.

    Args:
        revisits: revisits of the map in the order of time.
        settings: settings of the audit, with the tolerances.
        limits: settings of the verdict.
        path_m: length of the path [m], from which the largest drift that could hide is computed; None if there are no sums
            of spans or any of them is torn, so that drift of any size could hide.
    """
    sure = [r for r in revisits if r.sure]
    if not sure:
        return Finding(VerdictStatus.PASS, _explain_no_revisit(revisits, settings, path_m), judged=False)
    off, excused = [r for r in sure if r.torn], [r for r in sure if r.excused]
    p_value = find_smallest(r.p_value for r in sure)
    reason = f"{len(off)} of {count_of(len(sure), 'revisit')} {is_or_are(len(off))} torn"
    status, explanation = VerdictStatus.PASS, ""
    if off:
        worst = max(off, key=lambda one: one.distance_m)
        reason += f", by up to {worst.distance_m:.2f} m"
        if any(r.stated_covariance is not None for r in off):
            reason += ", more than the covariances of the trajectory explain"
        explanation = f"the trajectory drifts: two passes of a place lie {worst.distance_m:.2f} m apart"
        torn = Share(len(off), len(sure))
        status = torn.judge(_REVISITS_WARN, _REVISITS_FAIL)
        # a single torn revisit may join two places that only look alike
        if status is not VerdictStatus.FAIL and any(a.torn and b.torn for a, b in itertools.pairwise(sure)):
            status = VerdictStatus.WARN
        if status is VerdictStatus.NOT_JUDGED:
            reason += f", too few to judge drift by: the share of torn revisits may be {torn.describe_range()}"
    beside = _find_agreeing_row(sure, settings, limits)
    if beside:
        apart_m = float(np.median([one.distance_m for one in beside]))
        row = f"{count_of(len(beside), 'revisit')} in a row agree on {apart_m:.2f} m between their passes"
        reason += f", and {row}"
        explanation = explanation or f"one pass lies beside the other: {row}"
        status = VerdictStatus.WARN if status in (VerdictStatus.PASS, VerdictStatus.NOT_JUDGED) else status
    elif not off:
        some = sum(one.p_value < share_of_false_alarms(limits) for one in sure)
        if some:
            reason += f"; {some} {is_or_are(some)} off by more than chance explains, each by less than is tolerated"
    if excused:
        farthest = max(r.distance_m for r in excused)
        said = f"the passes of {len(excused)} of them lie up to {farthest:.2f} m apart"
        reason += f", and {said}, which the covariances of the trajectory explain one by one"
        honesty = judge_honesty(sure)
        is_explained = honesty is None or honesty.nees <= honesty.most
        if not is_explained:
            reason += f", but not all together: over {count_of(len(sure), 'revisit')}, these covariances are too small"
        if status is VerdictStatus.PASS and Share(len(excused), len(sure)).is_above(_REVISITS_WARN):
            status = VerdictStatus.WARN
            how = "as its own covariances allow" if is_explained else "and its own covariances are too small"
            explanation = f"the trajectory drifts, {how}: passes lie up to {farthest:.2f} m apart"
    cause = Cause.PASSES if explanation else None
    return Finding(status, reason, p_value=p_value, cause=cause, explanation=explanation)


def _find_agreeing_row(sure: Sequence[RevisitAudit], settings: AuditConfig, limits: VerdictConfig) -> list[RevisitAudit]:
    """Returns the longest series of sure, successive revisits that agree on an offset; an empty list if no revisits agree.

    `_ROW` successive revisits agree if each is off by more than chance explains, and the mean of their offsets is larger
    than is tolerated. The offset may change slowly along a longer series.
    """
    rare = [bool(one.p_value < share_of_false_alarms(limits)) for one in sure]
    agree = [
        all(rare[k : k + _ROW]) and _measure_mean(sure[k : k + _ROW]) > tolerate_row(settings)
        for k in range(len(sure) - _ROW + 1)
    ]
    rows = [[k for k, _ in row] for agreeing, row in itertools.groupby(enumerate(agree), lambda one: one[1]) if agreeing]
    longest = max(rows, key=len, default=[])
    return list(sure[longest[0] : longest[-1] + _ROW]) if longest else []


def _measure_mean(row: Sequence[RevisitAudit]) -> float:
    """Returns the length [m] of the mean offset of revisits, with each offset turned into the map's frame."""
    return float(np.hypot(*np.mean([one.moved for one in row], axis=0)))


def _explain_no_revisit(revisits: Sequence[RevisitAudit], settings: AuditConfig, path_m: float | None) -> str:
    """Returns in words why no revisit shows a drift, and how large a drift could hide.

    If the length of the path, `path_m` [m], is None, a drift of any size could hide.
    """
    why = "no place is passed twice"
    if revisits:
        why = f"none of {count_of(len(revisits), 'revisit')} is sure enough to show it"
    if path_m is None:
        return f"drift: {why}, so that drift of any size could hide"
    metres, radians = tolerate_sum(settings)
    parts = max(path_m / LENGTHS_M[-1], 1.0)
    most_m = parts * metres + 0.5 * path_m * parts * radians
    return f"drift: {why}, so that a drift of up to {most_m:.0f} m at the end could hide"
