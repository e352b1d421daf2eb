"""The verdict on a run, and what its reader should know first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from typing import Final

import numpy as np

from mqslam.auditing.findings import judge_windows
from mqslam.auditing.verdict import Finding, Share, VerdictStatus, verdict_of
from mqslam.core.measurement import Measurement, Status
from mqslam.core.recording import Recording
from mqslam.detection.stage import warn_of_unread
from mqslam.mapping.render import select_moving
from mqslam.psi.tracking.state import LONGEST_COAST_S
from mqslam.results.run_scale import judge_scale
from mqslam.solution import CHECK, Run

# Shortest stop that a warning names [s]; shorter ones are usual in traffic.
_STOP_S = 10.0
# With a larger share of lost scans than this the trajectory is mostly prediction. Any lost scan is worth a look.
_LOST_FAIL = 0.2
# A larger share than this of scans that do not observe every direction is worth a look.
_DEGENERATE_WARN = 0.1

# Ratio of psi per point after optimisation to that before, above which optimisation made the map worse. Passes that loops
# lay on each other cost a little more than each pass alone.
_WORSE = 1.1
_LISTED: Final = 5  # gaps that are named one by one, so that the warnings stay readable
_SEEN_BY_CHIRPS: Final = "; the velocities by chirps carry the trajectory there"
_NEAR_S: Final = 5.0  # stretches that are less than so long apart [s] are told in one line


def judge_run(run: Run) -> tuple[VerdictStatus, list[str]]:
    """Returns the verdict on a run's map, with its reasons, from the run alone.

    Only windows show the map. Without any, the map is not judged, and all other findings are reasons.
    """
    if run.checked is None and CHECK in run.crashes:
        crash = f"{CHECK} crashed ({run.crashes[CHECK]}), so that nothing has judged the map; run.log has the traceback"
        seen = [Finding(VerdictStatus.NOT_JUDGED, crash)]
    elif run.checked is None:
        seen = judge_windows([], len(run.optimised))
    else:
        seen = list(chain.from_iterable(run.checked.tests.values()))
    others = [*_judge_direction(run), *judge_scale(run), *_judge_track(run), *_judge_whole_map(run)]
    if not run.checks:
        others = [replace(f, status=VerdictStatus.NOT_JUDGED) if f.status is VerdictStatus.WARN else f for f in others]
    return verdict_of([*_judge_passes(run), *seen, *others])  # psi across passes sees a torn map: it leads


def _judge_direction(run: Run) -> list[Finding]:
    """Returns that the radar is mirrored, where sensors that know nothing of each other turn the other way."""
    opposite = run.sensors.opposite
    if not opposite:
        return []
    who = f"{', '.join(opposite[:-1])} and {opposite[-1]} turn the other way than the radar"
    remedy = "set sensor.clockwise: false, as for a radar that is mounted upside down"
    return [Finding(VerdictStatus.WARN, f"the map is mirrored: {who}; {remedy}")]


def list_warnings(run: Run, recording: Recording) -> list[str]:
    """Returns what happened during a run that its reader should know first."""
    warnings = [*recording.faults, *warn_of_unread(run.unread), *run.warnings]
    warnings += _warn_of_gaps(recording.gaps(), LONGEST_COAST_S)
    for status, what in ((Status.LOST, "lost track"), (Status.DEGENERATE, "did not observe every direction")):
        remark = _SEEN_BY_CHIRPS if status is Status.DEGENERATE and _has_velocities(run, status) else ""
        warnings += [f"{line}{remark}" for line in _warn_of_stretches(what, find_stretches(run.measurements, status))]
    if run.refined.refused:
        warnings.append("the refinement made psi between passes larger: the poses before it are kept")
    stops = find_stops(run, recording)
    warnings += [
        f"stood still from {begin:.1f} s to {end:.1f} s: the map holds the first scan of that time only"
        for begin, end in stops
    ]
    return warnings


def find_stops(run: Run, recording: Recording) -> list[tuple[float, float]]:
    """Returns long spans [s] in which no scan moved on, so that the map holds only the first of them."""
    moved = recording.start_times[select_moving(run.optimised.poses)]
    ends = np.append(moved[1:], recording.duration_s)
    return [(float(a), float(b)) for a, b in zip(moved, ends, strict=True) if b - a >= _STOP_S]


def find_stretches(measurements: Sequence[Measurement], status: Status) -> list[tuple[float, float]]:
    """Returns spans [s] of successive measurements that share a status."""
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
    """Returns whether velocities by chirps join the graph at every measurement that has a status."""
    velocities = run.sensors.velocities
    if velocities is None or velocities.edges is None:
        return False
    return all(k in velocities.edges for k, m in enumerate(run.measurements) if m.status is status)


def _warn_of_stretches(what: str, spans: Sequence[tuple[float, float]]) -> list[str]:
    """Returns a warning for each stretch, or one for several that are near each other.

    Args:
        what: happened in each of them.
        spans: their first and last times [s], in order.
    """
    groups: list[list[tuple[float, float]]] = []
    for begin, end in spans:
        if groups and begin - groups[-1][-1][1] < _NEAR_S:
            groups[-1].append((begin, end))
        else:
            groups.append([(begin, end)])
    return [_describe_stretches(what, group) for group in groups]


def _describe_stretches(what: str, group: Sequence[tuple[float, float]]) -> str:
    """Returns when something happened, in words."""
    place = f"from {group[0][0]:.1f} s to {group[-1][1]:.1f} s"
    if len(group) == 1:
        return f"{what} {place}"
    lasted_s = sum(end - begin for begin, end in group)
    return f"{what} in {len(group)} stretches {place}, {lasted_s:.1f} s in all"


def _judge_track(run: Run) -> list[Finding]:
    """Returns what the scans that were read and tracked say about the map."""
    measurements = run.measurements
    lost, degenerate = _count_status(measurements, Status.LOST), _count_status(measurements, Status.DEGENERATE)
    findings = [Finding(VerdictStatus.PASS, "no scan lost track")]
    if lost.count:
        grave = lost.is_above(_LOST_FAIL)
        reason = f"{lost.count} of {lost.total} scans lost track and follow the prediction"
        findings = [Finding(VerdictStatus.FAIL if grave else VerdictStatus.WARN, reason)]
    if run.unread:
        reason = f"{len(run.unread)} of {len(run.optimised)} polar scans could not be read"
        findings.append(Finding(VerdictStatus.WARN, reason))
    if degenerate.is_above(_DEGENERATE_WARN):
        reason = f"{degenerate.count} of {degenerate.total} scans do not observe every direction of motion"
        findings.append(Finding(VerdictStatus.WARN, reason))
    return findings


def _judge_passes(run: Run) -> list[Finding]:
    """Returns what optimisation made of psi across passes; nothing where psi cannot tell."""
    if not _can_compare(run):
        return []
    return _compare_psi("psi per point across passes", run.refined.psi_before, run.refined.psi_across)


def _judge_whole_map(run: Run) -> list[Finding]:
    """Returns what the whole map shows, and what optimisation made of it; nothing where psi cannot tell.

    A radar that stood still leaves a map of one scan: none of its points is matched.
    """
    if run.unoptimised is not None:
        reason = f"the pose graph could not be optimised: the trajectory is {run.frontend}'s motions, chained"
        return [Finding(VerdictStatus.FAIL, reason)]
    if run.checks and run.map_optimised.matched_share == 0.0:
        reason = "no point of the map was seen by two of its scans, so that nothing shows how good it is"
        return [Finding(VerdictStatus.NOT_JUDGED, reason)]
    if not _can_compare(run):
        return []
    before, after = run.map_odometry.psi_per_point, run.map_optimised.psi_per_point
    findings = _compare_psi("psi per point", before, after)
    if run.refined.psi_across is not None:  # the returns of two passes are neighbours only once the passes meet
        findings = [replace(finding, status=VerdictStatus.PASS) for finding in findings]
        told = "the returns of other passes count in it once the passes meet, so that psi across passes decides"
        return [replace(finding, reason=f"{finding.reason}: {told}") for finding in findings]
    return [replace(finding, reason=f"{finding.reason}: {_explain_psi(finding)}") for finding in findings]


def _can_compare(run: Run) -> bool:
    """Returns whether optimisation had something to do, and psi can tell what it made of the map."""
    if run.unoptimised is not None or not (run.odometry_factors or run.loops):
        return False
    return bool(run.checks) and bool(run.map_optimised.matched_share)


def _compare_psi(what: str, before: float | None, after: float | None) -> list[Finding]:
    """Returns whether psi became larger by optimisation; nothing where it is not known or was zero.

    Args:
        what: names the psi that is compared.
        before: psi per point before optimisation, or None.
        after: psi per point after it, or None.
    """
    if before is None or after is None or before <= 0.0:
        return []
    ratio = after / before
    status = VerdictStatus.FAIL if ratio > _WORSE else VerdictStatus.PASS
    return [Finding(status, f"{what} is {ratio:.2f} times that of the map before optimisation")]


def _explain_psi(finding: Finding) -> str:
    """Returns what psi per point over neighbours in time, which hardly sees drift, says about a map, in words."""
    if finding.status is VerdictStatus.PASS:
        return f"it did not blur the map, which takes more than {_WORSE:g} times, but drift hardly shows in this number"
    return f"it blurred the map, which takes more than {_WORSE:g} times"


def _count_status(measurements: Sequence[Measurement], status: Status) -> Share:
    """Returns how many of the measurements have a status."""
    return Share(sum(m.status is status for m in measurements), len(measurements))


def _warn_of_gaps(gaps: list[tuple[int, float]], longest_coast_s: float) -> list[str]:
    """Returns warnings of the first gaps, and what is missing in all where there are many.

    Args:
        gaps: number of the scan before each gap, and what is missing [s].
        longest_coast_s: longest gap that the tracker bridges [s].
    """
    warnings = [_describe_gap(scan, missing_s, longest_coast_s) for scan, missing_s in gaps[:_LISTED]]
    if len(gaps) > _LISTED:
        missing_s = sum(missing for _, missing in gaps)
        warnings.append(f"{len(gaps) - _LISTED} more radar gaps; {missing_s:.2f} s are missing in all")
    return warnings


def _describe_gap(scan: int, missing_s: float, longest_coast_s: float) -> str:
    where = f"of {missing_s:.2f} s after scan {scan} (counted from 0)"
    if missing_s < longest_coast_s:
        return f"radar gap {where}"
    return f"jump of the clock or pause {where}: the poses beyond it are a guess unless a loop closure ties them"
