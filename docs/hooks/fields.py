"""What the entries of summary.json (of a run) and audit.json mean, with their units.

The errors against ground truth are described where they are computed, in `mqslam.evaluation`, and the tests in the table of
tests. `tests/cli/test_fields_page.py` fails if a run or an audit writes an entry that has no row here, or if a row's entry
is written by no module.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from mqslam.evaluation import Evaluation

_ABOUT_WINDOWS = {
    "torn": "number that are torn: off by more than chance explains and more than is tolerated",
    "torn_share_at_least": "lower confidence bound (95 %) of the share that is torn",
    "torn_share_at_most": "upper confidence bound (95 %) of the share that is torn",
}
_POSE = {
    "x": "x of the sensor there [m], in the frame of the trajectory",
    "y": "y of the sensor there [m]",
    "yaw": "its heading [rad]",
}
_OFFSET = {
    "dx": "correction forward [m], in the sensor's frame",
    "dy": "correction to the left [m]",
    "dyaw": "correction of the heading, counter-clockwise [rad]",
}
_P_VALUE = {"p_value": "probability of so large a correction on a good map; null where nothing was judged"}
_SIGMAS = {f"sigma_{axis}": f"standard deviation of {name}" for axis, name in zip(("x", "y", "yaw"), _OFFSET, strict=True)}
_ROTATION = {
    "axis": "axis of the gyroscope that is the radar's vertical",
    "upside_down": "whether this axis points down",
    "scale": "rotation of the radar per rotation that the gyroscope reads",
    "sigma_scale": "standard deviation of `scale`",
    "late_s": "how late its clock is [s]",
    "sigma_late_s": "standard deviation of `late_s` [s]",
    "bias_radps": "bias [rad/s]",
    "white_noise": "white noise [rad/s/sqrt(Hz)]",
    "bias_walk": "random walk of the bias [rad/s/sqrt(s)]",
}
_SENSOR = {
    "source": "file or topic of its data",
    "used": "whether it joins the graph",
    "statements": "sentences about it, as report and terminal show them",
    "factors": "number of its factors in the graph",
    "moved_m": "how far it moves the trajectory, RMS [m]",
    "turned_rad": "how far it turns the trajectory's end [rad]",
}
_SHARED = {
    "mqslam_version": "version that has written the file",
    "dataset.format": "layout of the recording",
    "dataset.path": "path of the recording, as it was given",
    "dataset.duration_s": "duration [s]",
    "dataset.length_m": "length of the path [m]",
    "dataset.points": "number of points of the map",
    "final_psi.over_best_of_windows": "psi within windows, divided by the least that the same returns can have there",
    "final_psi.over_best_of_passes": "the same across passes of one place; null where no place is passed twice",
    "steps.count": "number of places at which the scans after are laid on those before",
    "steps.judged": "number of these that show enough to judge",
    "steps.jumps": "number of places where the map jumps",
    "steps.median_m": "median of how far a step moves points [m]",
    "spans.count": "number of spans: scans some 30 m of path apart that are laid on each other",
    "spans.torn": "number of spans that are off",
    "spans.median_m": "median offset of a span [m]",
    "sums.count": "number of sums of successive spans, over 60 to 300 m of path",
    "sums.torn": "number of sums that are off",
    "pooled.spans": "number of spans whose corrections are pooled",
    "pooled.forward_per_m": "motion forward that the trajectory lacks, per metre of path, by all spans together",
    "pooled.left_per_m": "motion to the left that it lacks, per metre",
    "pooled.yaw_per_m": "yaw to the left that it lacks [rad/m]",
    "pooled.late_s": "how late the stamps are [s], negative if early",
    "pooled.turns": "number of turns of the vehicle that show where the sensor sits",
    "pooled.ahead_m": "how far the sensor sits ahead of where the trajectory has it [m]",
    "pooled.left_m": "how far it sits to the left of that [m]",
    "tests.NAME.status": "verdict of a test of [the table](../explanation/verdict.md): pass, warn, fail or not judged",
    "tests.NAME.p_value": "its least p-value; null for a test without one",
    "tests.NAME.reasons": "its findings as sentences",
    "false_alarms.rate": "probability with which the tests may together call a good map bad",
    "false_alarms.p_value_below": "p-value below which one test may call a map bad",
    "verdict.status": "pass, warn, fail or not judged",
    "verdict.diagnosis": "the most likely cause, and what mends it",
    "verdict.reasons": "what each test found, as sentences",
    "not_judged": "sentences on what could not be judged",
    "warnings": "what a reader should know before the numbers",
} | {
    f"pooled.{name}{ending}": meaning
    for name in ("forward_per_m", "left_per_m", "yaw_per_m", "late_s", "ahead_m", "left_m")
    for ending, meaning in (("_sigma", "its standard deviation"), ("_p_value", "its p-value against zero"))
}


def _put(prefix: str, fields: dict[str, str]) -> dict[str, str]:
    """Returns fields with a prefix before their names."""
    return {prefix + name: meaning for name, meaning in fields.items()}


def _describe_errors() -> dict[str, str]:
    """Returns what each error against ground truth is, from the place where they are computed."""
    arguments = (Evaluation.__doc__ or "").split("Args:")[1]
    return {name: " ".join(text.split()).rstrip(".") for name, text in re.findall(r"(\w+): (.*?\.)\n", arguments, re.DOTALL)}


SUMMARY = _SHARED | {
    "frontend": "name of the front end",
    "before": "what the trajectory before optimisation is: odometry, or the front end's motions",
    "frame": "whose poses are written: radar, lidar or vehicle",
    "doppler_beta": "Doppler shift that was used: range per closing speed [s]",
    "doppler_sigma": "its standard deviation [s], 0 where it was stated",
    "range_errors": "null where fewer than five stretches of the drive show the errors of the ranges, or an object",
    "range_errors.range_offset_m": "range offset that psi shows [m]",
    "range_errors.range_offset_sigma_m": "its standard deviation [m]",
    "range_errors.range_offset_used_m": "range offset that was used [m]",
    "range_errors.doppler_beta": "Doppler shift that psi shows together with the offset [s]",
    "range_errors.doppler_sigma": "its standard deviation [s]",
    "range_errors.correlation": "correlation of the two estimates",
    "range_errors.length_per_offset": "relative change of the trajectory's length per metre of offset [1/m]",
    "range_errors.stretches": "number of stretches that show them",
    "range_errors.statements": "sentences about them",
    "range_scale.factor": "what the ranges are multiplied by; 1 where no other sensor contradicts them",
    "range_scale.sigma": "standard deviation of the factor",
    "range_scale.prior": "standard deviation of the factor without the sensors of the graph",
    "range_scale.statements": "sentences about it",
    "dataset.revolutions": "number of scans that are used",
    "dataset.left_out": "number of scans that are left out because the lidar had hardly moved; only for lidars",
    "dataset.unread": "number of scans that could not be read",
    "psi.odometry": "the estimator's psi of the whole map before optimisation",
    "psi.optimised": "the same after optimisation",
    "psi.per_point_odometry": "psi per point before; compare it only with the value after",
    "psi.per_point_optimised": "psi per point after",
    "psi.across_passes_odometry": "psi per point of later passes against earlier ones, before; null without such",
    "psi.across_passes_optimised": "the same after",
    "psi.matched_odometry": "share of the points that another scan saw too, before",
    "psi.matched_optimised": "the same after",
    "inflation.windows": "number of windows that were judged",
    **_put("inflation.", _ABOUT_WINDOWS),
    "inflation.median": "median inflation of the windows; 2.37 for a right trajectory",
    "last_pose": "null where the covariances are not known, or an object",
    "last_pose.sigma_along_m": "standard deviation of the last pose, relative to the first one, along its heading [m]",
    "last_pose.sigma_across_m": "the same across [m]",
    "last_pose.sigma_yaw_rad": "the same of the heading [rad]",
    "last_pose.prior_share": "share of the position's variance that comes from a prior, the scale of the ranges",
    "factors.odometry": "number of odometry factors in the graph",
    "factors.psi": "number of motions that the front end measured, by whatever front end",
    "factors.loop": "number of loop closures",
    "factors.loop_rejected": "number of loop closures that were rejected",
    "factors.refinement": "number of scans that were laid on earlier passes",
    "sensors.gyroscope": "null without a gyroscope, or an object",
    **_put("sensors.gyroscope.", _SENSOR | _ROTATION),
    "sensors.gnss": "null without GNSS, or an object",
    **_put("sensors.gnss.", _SENSOR),
    "sensors.gnss.antenna_x_m": "antenna ahead of the radar [m]",
    "sensors.gnss.antenna_y_m": "antenna to the radar's left [m]",
    "sensors.gnss.sigma_antenna_x_m": "standard deviation of `antenna_x_m` [m]",
    "sensors.gnss.sigma_antenna_y_m": "standard deviation of `antenna_y_m` [m]",
    "sensors.gnss.rejected": "number of fixes that hardly count, as jumps",
    "sensors.gnss.white_m": "white noise of a fix [m]",
    "sensors.gnss.walk_m": "random walk of the receiver's error [m/sqrt(s)]",
    "sensors.chirps": "null without up and down chirps, or an object",
    **_put("sensors.chirps.", _SENSOR),
    "sensors.chirps.scale": "distance by psi per distance by the velocities that the chirps measure",
    "sensors.chirps.sigma_scale": "standard deviation of `scale`",
    "sensors.chirps.bias_forward_mps": "bias forward [m/s]",
    "sensors.chirps.bias_left_mps": "bias to the left [m/s]",
    "mount": "null where nothing says where the radar sits on the vehicle, or an object",
    "mount.x_m": "radar ahead of the vehicle's origin [m]",
    "mount.y_m": "radar to the left of it [m]",
    "mount.yaw_rad": "radar turned to the left [rad]",
    "mount.sigma_x_m": "standard deviation of `x_m` [m]",
    "mount.sigma_y_m": "standard deviation of `y_m` [m]",
    "mount.sigma_yaw_rad": "standard deviation of `yaw_rad` [rad]",
    "mount.source": "where the mount is from",
    "mount.statements": "sentences about it",
    "evaluation": "errors of the optimised trajectory against ground truth, or null without it",
    **_put("evaluation.", _describe_errors()),
    "evaluation_odometry": "the same errors of the trajectory before optimisation, or null",
    **_put("evaluation_odometry.", _describe_errors()),
    "runtime_s.STAGE": "time that a stage of the run took [s]; `total` is all of it. For a resumed run, the time since "
    "it was resumed",
    "peak_rss_mb": "largest memory of the run and its processes [MB]",
    "run_key": "a string that changes with recording, settings, front end and sensors",
}
"""Meaning of the entries of a run's summary.json."""

_AUDIT = _SHARED | {
    "dataset.sweeps": "number of scans, or of sweeps that a cloud was divided into",
    "trajectory": "where the trajectory is from; null for a cloud without one",
    "extrinsics": "x, y [m] and yaw [degrees] of the sensor in the frame whose trajectory was given, or null",
    "notes": "how the data were understood",
    "threshold": "inflation above which a window may be torn",
    "bend_m": "a window whose correction moves its points by less than this is not torn [m]",
    "speeds.sure": "number of windows whose speed the scans show for sure",
    "speeds.contradicted": "number of these that contradict the trajectory",
    "speeds.error_median": "median error of the speed [m/s]",
    "speeds.capture_m": "largest error of a window that psi can find [m]",
    "speeds.capture_mps": "the same as a speed [m/s]",
    "speeds.searched_mps": "largest error of the speed that is searched [m/s]",
    "windows.count": "number of windows",
    "windows.undecided": "number of windows that show too little to judge",
    **_put("windows.", _ABOUT_WINDOWS),
    "windows.inflation_median": "median inflation; 2.37 for a right trajectory",
    "windows.psi_per_point": "mean psi per point of the windows",
    "windows.matched": "mean share of points that another scan of the window saw too",
    "revisits": "null for a cloud without a trajectory, or an object",
    "revisits.count": "number of places that are passed again",
    "revisits.sure": "number of these whose registration is sure",
    **_put("revisits.", _ABOUT_WINDOWS),
    "revisits.median_m": "median distance between two passes [m], of the sure ones",
    "revisits.worst_m": "largest distance of a torn one [m], or null",
    "gyroscope": "comparison with a gyroscope, where there is one",
    "gyroscope.source": "file or topic of its data",
    "gyroscope.agrees": "whether it agrees with the trajectory; null where it cannot tell",
    "gyroscope.statement": "the comparison as a sentence",
    "gyroscope.differ_rad": "robust standard deviation of what the two still differ by over a scan [rad]",
    **_put("gyroscope.", _ROTATION),
    "covariances": "how the covariances that the trajectory states agree with its revisits; null where it states none",
    "covariances.revisits": "number of sure revisits by which they were judged",
    "covariances.nees": "mean squared offset in units of its covariance, per degree of freedom; 1 where they are right",
    "covariances.least": "lower end of what chance makes of it (95 %) where they are right",
    "covariances.most": "upper end of it",
    "covariances.statement": "the finding as a sentence",
    "baseline": "comparison with the audit that --baseline names, or null",
    "baseline.path": "folder of that audit",
    "baseline.worse": "sentences on the tests, and the verdict, that are worse than there",
    "per_window[].t0": "begin of the window [s since the recording's start]",
    "per_window[].t1": "its end [s]",
    **_put("per_window[].", _POSE),
    "per_window[].torn": "whether it is torn; null where it shows too little",
    "per_window[].by_speed": "whether it is torn only because the scans contradict its speed",
    "per_window[].undecided": "why it shows too little, or null",
    "per_window[].inflation": "squared correction in units of its covariance: chi-square with 3 degrees of freedom",
    **_put("per_window[].", _P_VALUE | _OFFSET | _SIGMAS),
    "per_window[].dv": "correction of the speed [m/s]",
    "per_window[].domega": "correction of the yaw rate [rad/s]",
    "per_window[].size_m": "how far the correction moves its points [m]",
    "per_window[].psi_per_point": "psi per point of the window as it is",
    "per_window[].psi_per_point_best": "the same after the best correction",
    "per_window[].matched": "share of points that another scan of the window saw too",
    "per_window[].matched_best": "the same after the best correction",
    "per_window[].points": "number of its points",
    "per_window[].speed_error": "error of its speed [m/s], where the scans show it for sure",
    "per_window[].map_entropy": "mean differential entropy of the points' neighbourhoods [nat]",
    "per_window[].plane_variance": "mean smallest variance of the neighbourhoods [m^2]",
    "per_window[].joint_entropy": "entropy of a point's neighbourhood in all scans less that in its own scan, mean [nat]",
    "per_window[].grid_entropy": "entropy of the window's evidence grid per cell seen [nat]",
    "per_revisit[].t_earlier": "time of the earlier pass [s]",
    "per_revisit[].t_later": "time of the later pass [s]",
    **_put("per_revisit[].", _POSE),
    "per_revisit[].torn": "whether the passes are torn; null where the registration is not sure",
    "per_revisit[].sure": "whether the registration is sure",
    **_put("per_revisit[].", _OFFSET | _SIGMAS),
    "per_revisit[].claimed_sigma_x": "standard deviation of `dx` that the trajectory's covariances state, or null",
    "per_revisit[].claimed_sigma_y": "the same of `dy`",
    "per_revisit[].claimed_sigma_yaw": "the same of `dyaw`",
    "per_revisit[].inflation": "squared correction in units of its covariance",
    **_put("per_revisit[].", _P_VALUE),
    "per_revisit[].matched": "share of the later pass's points that lie on the earlier one",
    "per_revisit[].psi_per_point": "psi per point of the two passes as they are",
    "per_revisit[].psi_per_point_best": "the same after the best correction",
    "per_step[].t": "time of the step [s]",
    **_put("per_step[].", _POSE | _OFFSET),
    "per_step[].size_m": "how far the correction moves points [m]",
    "per_step[].matched": "share of points that match",
    **_put("per_step[].", _P_VALUE),
    "per_step[].torn": "whether the map jumps there; null where it shows too little",
    "per_span[].t_earlier": "time of the earlier scans [s]",
    "per_span[].t_later": "time of the later scans [s]",
    **_put("per_span[].", _POSE),
    "per_span[].path_m": "path between them [m]",
    **_put("per_span[].", _OFFSET),
    "per_span[].matched": "share of points that match",
    **_put("per_span[].", _P_VALUE),
    "per_span[].torn": "whether the span is off; null where it was not judged",
}
AUDIT = _AUDIT | {
    "mended.sentence": "with --mend: the result of mending in words",
    "mended.rounds": "number of rounds of mending",
    "mended.ties": "number of motions by psi with which the trajectory was mended",
    "mended.loops": "number of revisits by psi that hold it",
    "mended.moved_m": "how far the farthest pose was moved [m]",
    "mended.stretch": "length of the mended path per length of the given one",
    "mended.worse": "whether the mended trajectory is judged worse",
    "mended.ENTRY": "every entry above that depends on the trajectory, for the mended one",
}
"""Meaning of the entries of an audit's audit.json."""


def find_meaning(fields: dict[str, str], entry: str) -> str | None:
    """Returns what an entry means, or None if nothing describes it; words in capitals stand for any name."""
    if entry.startswith("mended.") and entry not in fields:
        return find_meaning(_AUDIT, entry.removeprefix("mended."))
    for pattern, meaning in fields.items():
        if entry == pattern or re.fullmatch(re.sub(r"[A-Z]{2,}", r"\\w+", re.escape(pattern)), entry):
            return meaning
    return None


def describe_fields() -> Iterator[str]:
    """Yields the lines of the page of the entries of summary.json and audit.json."""
    yield "# Entries of summary.json and audit.json\n"
    yield "An entry within an object has the object's name before it, and `[]` marks the objects of a list. Lengths are in"
    yield "metres, angles in radians and times in seconds, unless their meaning says otherwise; a value that is not known is"
    yield "`null`. Later versions may add entries. `audit.csv`, `revisits.csv`, `steps.csv` and `spans.csv` hold the lists."
    for name, fields in (("summary.json, of a run", SUMMARY), ("audit.json", AUDIT)):
        yield f"\n## {name}\n\n| entry | what it is |\n|---|---|"
        yield from (f"| `{entry}` | {meaning} |" for entry, meaning in fields.items())
    yield ""
