"""Judges the map of a run without ground truth, and lists the warnings that a reader of the results should know first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from mqslam.auditing.findings import judge_windows
from mqslam.auditing.odometry_check import is_wrong_scale, measure_speed_ratio, name_unit
from mqslam.auditing.sizes import WINDOW
from mqslam.auditing.table import sort_tests
from mqslam.auditing.verdict import Cause, Finding, Share, VerdictStatus
from mqslam.backend.range_scale import NOT_OF_RADAR
from mqslam.backend.sensors.gnss import FixUse
from mqslam.core.measurement import Measurement, Status
from mqslam.core.recording import Recording
from mqslam.core.wording import count_of, describe_times, explain_rest, join_words
from mqslam.detection.stage import warn_of_unread
from mqslam.errors import Remedy
from mqslam.mapping.render import select_moving
from mqslam.psi.tracking.state import LONGEST_COAST_S
from mqslam.solution import CHECK, Run

# Shortest stop that a warning names [s]; shorter ones are usual in traffic.
_STOP_S = 10.0
# With a larger share of lost scans than this, the map fails, because much of the trajectory is a prediction. With a smaller
# share, a warning is given.
_LOST_FAIL = 0.2
# If a larger share of the scans than this do not observe every direction, a warning is given.
_DEGENERATE_WARN = 0.1

# Ratio of psi per point after optimisation to psi per point before it, above which optimisation made the map worse. It may
# be a little above 1, since two passes that loops bring together have a higher psi than each pass alone.
_WORSE = 1.1
_LISTED: Final = 5  # largest number of gaps that are named one by one, so that the warnings stay readable
_SEEN_BY_CHIRPS: Final = "; velocities measured by chirps give the motion there"
_NEAR_S: Final = 5.0  # stretches that are less than this apart [s] are named in one line


def judge_run(run: Run) -> dict[str, list[Finding]]:
    """Returns the findings of each test of a run's map by the test's name.

    If the audit judged no window, nothing shows how good the map is. Warnings of the tests on sensors, tracking and graph
    then become `not judged`, so that they do not appear as a verdict on the map.
    """
    if run.checked is None and CHECK in run.crashes:
        crash = f"{CHECK} crashed ({run.crashes[CHECK]}), so that nothing has judged the map; run.log has the traceback"
        tests = {"windows": [Finding(VerdictStatus.NOT_JUDGED, crash)]}
    elif run.checked is None:
        tests = {"windows": judge_windows([], len(run.optimised))}
    else:
        tests = run.checked.tests
    others = {
        "sensors": [*tests.get("sensors", []), *_judge_direction(run), *_judge_scale(run)],
        "tracking": _judge_track(run),
        "graph": [*_judge_passes(run), *_judge_whole_map(run)],
    }
    if not run.checks:
        others = {name: list(map(_judge_nothing, findings)) for name, findings in others.items()}
    return sort_tests({**tests, **others})


def _judge_nothing(finding: Finding) -> Finding:
    """Returns a finding as it counts if no window was judged: `warn` becomes `not judged`, any other status stays."""
    return replace(finding, status=VerdictStatus.NOT_JUDGED) if finding.status is VerdictStatus.WARN else finding


def _judge_direction(run: Run) -> list[Finding]:
    """Returns the finding that the map is mirrored if other sensors turn the other way than the radar; else no finding."""
    opposite = run.sensors.opposite
    if not opposite:
        return []
    who = f"{join_words(opposite)} turn the other way than the radar"
    remedy = "set sensor.clockwise: false, as for a radar that is mounted upside down"
    reason = f"the map is mirrored: {who}"
    return [Finding(VerdictStatus.WARN, reason, cause=Cause.MIRROR, explanation=f"{reason}; {remedy}")]


def list_warnings(run: Run, recording: Recording) -> list[str]:
    """Returns the warnings about a run that a reader of its results should know first."""
    warnings = [*recording.faults, *warn_of_unread(run.unread), *run.warnings]
    warnings += explain_rest(len(recording), recording.left_out, WINDOW)
    warnings += _warn_of_gaps(recording.gaps(), recording.sensor_name)
    warnings += warn_of_lost(run.measurements)
    remark = _SEEN_BY_CHIRPS if _has_velocities(run, Status.DEGENERATE) else ""
    unobserved = find_stretches(run.measurements, Status.DEGENERATE)
    warnings += [f"{line}{remark}" for line in _warn_of_stretches("the scans did not observe every direction", unobserved)]
    if run.refined.refused:
        warnings.append("the refinement made psi between passes larger: the poses from before the refinement are kept")
    who, holds = f"the {recording.sensor_name} stood still", "the map holds only the first scan of that time"
    warnings += [f"{who} {describe_times(begin, end)}: {holds}" for begin, end in find_stops(run, recording)]
    return warnings


def warn_of_lost(measurements: Sequence[Measurement]) -> list[str]:
    """Returns a warning for each stretch in which a front end lost track; close stretches share one warning (`_NEAR_S`)."""
    return _warn_of_stretches("the front end lost track", find_stretches(measurements, Status.LOST))


def find_stops(run: Run, recording: Recording) -> list[tuple[float, float]]:
    """Returns begin and end [s since the recording's start] of each stop of at least `_STOP_S`."""
    moved = recording.start_times[select_moving(run.optimised.poses)]
    ends = np.append(moved[1:], recording.duration_s)
    return [(float(a), float(b)) for a, b in zip(moved, ends, strict=True) if b - a >= _STOP_S]


def find_stretches(measurements: Sequence[Measurement], status: Status) -> list[tuple[float, float]]:
    """Returns begin and end of each stretch of successive measurements with the given status [s since recording's start]."""
    spans: list[tuple[float, float]] = []
    for measurement in measurements:
        if measurement.status is not status:
            continue
        if spans and spans[-1][1] == measurement.t0:
            spans[-1] = (spans[-1][0], measurement.t1)
        else:
            spans.append((measurement.t0, measurement.t1))
    return spans


def _has_velocities(run: Run, status: Status) -> bool:
    """Returns whether the graph has velocities measured by chirps at every measurement that has the given status."""
    velocities = run.sensors.velocities
    if velocities is None or velocities.edges is None:
        return False
    return all(k in velocities.edges for k, m in enumerate(run.measurements) if m.status is status)


def _warn_of_stretches(what: str, spans: Sequence[tuple[float, float]]) -> list[str]:
    """Returns a warning for each stretch; stretches that are less than `_NEAR_S` apart share one warning.

    Args:
        what: clause that each warning begins with, such as `the front end lost track`.
        spans: beginning and end of each stretch [s since the recording's start], in the order of time.
    """
    groups: list[list[tuple[float, float]]] = []
    for span in spans:
        if groups and span[0] - groups[-1][-1][1] < _NEAR_S:
            groups[-1].append(span)
        else:
            groups.append([span])
    warnings = []
    for group in groups:
        place = describe_times(group[0][0], group[-1][1])
        lasted_s = sum(end - begin for begin, end in group)
        several = f"in {len(group)} stretches {place}, {lasted_s:.1f} s in all"
        warnings.append(f"{what} {place if len(group) == 1 else several}")
    return warnings


def _judge_track(run: Run) -> list[Finding]:
    """Returns the findings on scans that lost track, could not be read, or do not observe every direction of motion."""
    statuses = [m.status for m in run.measurements]
    scans = f"of the {count_of(len(statuses), 'scan')} after the first"
    lost, degenerate = (Share(statuses.count(status), len(statuses)) for status in (Status.LOST, Status.DEGENERATE))
    findings = [Finding(VerdictStatus.PASS, "no scan lost track")]
    if lost.count:
        grave = lost.is_above(_LOST_FAIL)
        reason = f"{lost.count} {scans} lost track, and their poses are predictions"
        status = VerdictStatus.FAIL if grave else VerdictStatus.WARN
        findings = [Finding(status, reason, cause=Cause.TRACKING, explanation=reason)]
    if run.unread:
        reason = f"{len(run.unread)} of {len(run.optimised)} polar scans could not be read"
        findings.append(Finding(VerdictStatus.WARN, reason, cause=Cause.PART, explanation=reason))
    if degenerate.is_above(_DEGENERATE_WARN):
        reason = f"{degenerate.count} {scans} do not observe every direction of motion"
        remedy = "there the map rests on the odometry" if run.odometry_factors else "odometry would help there"
        explanation = f"the scene shows too little, as in a tunnel or on open ground: {reason}; {remedy}"
        findings.append(Finding(VerdictStatus.WARN, reason, cause=Cause.TRACKING, explanation=explanation))
    return findings


def _judge_passes(run: Run) -> list[Finding]:
    """Returns a list of one finding, on how optimisation changed psi across passes; empty if psi cannot show the change."""
    compared = _compare_psi(run, run.refined.psi_before, run.refined.psi_across)
    return [_blame_optimisation(status, f"psi per point across passes {ratio}") for status, ratio in compared]


def _blame_optimisation(status: VerdictStatus, reason: str) -> Finding:
    """Returns a finding with the given status and reason, and the explanation that optimisation made the map worse."""
    explanation = "loops or other sensors bend the map, which was crisper before optimisation; try a run without them"
    return Finding(status, reason, cause=Cause.OPTIMISATION, explanation=explanation)


def _judge_whole_map(run: Run) -> list[Finding]:
    """Returns a list of one finding on the whole map, or an empty list if psi cannot show how optimisation changed it.

    The finding is (1) that the graph could not be optimised, or else (2) that no point of the map is matched, as if the
    sensor stood still and the map holds one scan, or else (3) the change of psi per point.
    """
    if run.unoptimised is not None:
        reason = f"the pose graph could not be optimised: the trajectory is {run.frontend}'s motions, chained"
        return [Finding(VerdictStatus.FAIL, reason, cause=Cause.OPTIMISATION, explanation=reason)]
    if run.checks and run.map_optimised.matched_share == 0.0:
        reason = "no point of the map was seen by two of its scans, so that nothing shows how good the map is"
        return [Finding(VerdictStatus.NOT_JUDGED, reason)]
    findings = []
    for status, ratio in _compare_psi(run, run.map_odometry.psi_per_point, run.map_optimised.psi_per_point):
        bound = f"a ratio above {_WORSE:g}"
        meaning = f"optimisation blurred the map, as {bound} shows"
        if run.refined.psi_across is not None:  # the returns of two passes are neighbours only once the passes meet
            status = VerdictStatus.PASS
            meaning = "it also counts the returns of other passes once the passes meet, so psi across passes decides instead"
        elif status is VerdictStatus.PASS:
            meaning = f"optimisation did not blur the map ({bound} would show that), but drift hardly shows in this number"
        findings.append(_blame_optimisation(status, f"psi per point {ratio}: {meaning}"))
    return findings


def _compare_psi(run: Run, before: float | None, after: float | None) -> list[tuple[VerdictStatus, str]]:
    """Returns a list of one pair: a status, `fail` if optimisation raised psi per point too much, and the ratio in words.

    `before` and `after` are psi per point before and after optimisation. The list is empty if psi is not known or was not
    positive, if the graph had nothing to optimise, if no window was judged, or if no point of the map is matched.
    """
    is_optimised = run.unoptimised is None and bool(run.odometry_factors or run.loops)
    if not (is_optimised and run.checks and run.map_optimised.matched_share) or after is None or not before or before < 0.0:
        return []
    ratio = after / before
    status = VerdictStatus.FAIL if ratio > _WORSE else VerdictStatus.PASS
    return [(status, f"is {ratio:.2f} times its value before optimisation")]


def _warn_of_gaps(gaps: list[tuple[int, float]], sensor: str) -> list[str]:
    """Returns warnings of the first `_LISTED` gaps and, if there are more, of the time that is missing in all.

    Args:
        gaps: index of the scan before each gap, and the missing time [s].
        sensor: name of the sensor in the warnings.
    """
    warnings = []
    for scan, missing_s in gaps[:_LISTED]:
        where = f"of {missing_s:.2f} s after scan {scan} (counted from 0)"
        if missing_s < LONGEST_COAST_S:
            warnings.append(f"{sensor} gap {where}")
        else:
            guess = "the poses after it are guesses unless a loop closure connects them to poses before it"
            warnings.append(f"jump of the clock or pause {where}: {guess}")
    if len(gaps) > _LISTED:
        missing_s = sum(missing for _, missing in gaps)
        warnings.append(f"{len(gaps) - _LISTED} more {sensor} gaps; {missing_s:.2f} s are missing in all")
    return warnings


def _judge_scale(run: Run) -> list[Finding]:
    """Returns a finding if odometry contradicts the trajectory's scale, and another if GNSS fixes do; else no finding."""
    reasons, ratio, fixes = [], measure_ratio(run), run.sensors.fixes
    stretch = None if fixes is None else fixes.stretch
    if ratio is not None and is_wrong_scale(ratio):
        remedy = f"or range bins {1.0 / ratio:.3g} times as long would fit: {Remedy.GIVE_RANGE_RESOLUTION}"
        if run.range_scale == NOT_OF_RADAR:
            remedy = "or the ranges of the lidar are"
        if _shows_scale(fixes) and not (stretch and is_wrong_scale(stretch)):
            remedy = "mend odometry's speeds, since GNSS agrees with the radar"
        reasons.append(
            f"the trajectory is {ratio:.3g} times as fast as odometry: odometry's scale is wrong{name_unit(ratio)}, {remedy}"
        )
    if stretch is not None and is_wrong_scale(stretch):
        reasons.append(
            f"GNSS fixes lie {stretch:.3g} times as far apart as the trajectory has them: range bins "
            f"{stretch:.3g} times as long would fit: {Remedy.GIVE_RANGE_RESOLUTION}"
        )
    return [Finding(VerdictStatus.WARN, reason, cause=Cause.SCALE, explanation=reason) for reason in reasons]


def _shows_scale(fixes: FixUse | None) -> bool:
    """Returns whether GNSS fixes show the scale of the map, which they do if they are used or if they contradict it."""
    return fixes is not None and (fixes.edges is not None or fixes.stretch is not None)


def list_unknowns(run: Run, recording: Recording) -> list[str]:
    """Returns lines on errors of the sensor that psi cannot show; no line if odometry or GNSS shows the scale of the map.

    Psi depends neither on the map's scale, nor on an offset of all azimuths, nor on a delay of all stamps.
    """
    if measure_ratio(run) is not None or _shows_scale(run.sensors.fixes):
        return []
    unchecked = "neither odometry nor GNSS shows enough to check it"
    if not recording.range_resolution:
        return [f"the scale of the map rests on the ranges that the lidar measures: {unchecked}"]
    known = "assumed" if recording.is_resolution_assumed else "stated"
    length = f"range bins of {recording.range_resolution:.4g} m, a value that is {known}"
    return [
        f"the scale of the map rests on {length}: {unchecked}",
        "an offset of all azimuths and a delay of all stamps would leave the map unchanged: only another sensor shows them",
    ]


def measure_ratio(run: Run) -> float | None:
    """Returns the median speed of the trajectory divided by the median speed of odometry; None if it is not known."""
    return measure_speed_ratio(run.optimised, run.odometry) if run.odometry_factors else None
