"""Words and sentences for messages, such as names of sensors, plurals, directions and the uncertainty of a pose."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any


def name_sensor(*, is_lidar: bool) -> str:
    """Returns the name of the sensor that took a recording, for messages: `lidar` or `radar`."""
    return "lidar" if is_lidar else "radar"


def count_of(number: int, noun: str) -> str:
    """Returns a number with its noun, such as `1 scan` or `2 scans`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def join_words(words: Sequence[str]) -> str:
    """Returns words as a list with `and` before the last, such as `a, b and c`."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def is_or_are(number: int) -> str:
    """Returns `is` for one thing, and `are` for any other number of things."""
    return "is" if number == 1 else "are"


def describe_times(begin_s: float, end_s: float) -> str:
    """Returns two times [s] in words, such as `from 2.0 s to 3.5 s`, or `at 2.0 s` if both are written alike."""
    begin, end = f"{begin_s:z.1f} s", f"{end_s:z.1f} s"
    return f"at {begin}" if begin == end else f"from {begin} to {end}"


def left_or_right(value: float) -> str:
    """Returns `left` for a coordinate y or a yaw of zero or more, else `right`."""
    return "left" if value >= 0.0 else "right"


def list_reasons(verdict: Mapping[str, Any]) -> list[str]:
    """Returns the reasons of a verdict that its diagnosis does not contain yet; an empty list for a verdict that passes.

    Args:
        verdict: entry `verdict` of a summary.
    """
    if verdict.get("status") == "pass":
        return []
    diagnosis = str(verdict.get("diagnosis", ""))
    return [str(reason) for reason in verdict.get("reasons") or () if str(reason) not in diagnosis]


def describe_left_out(dataset: Mapping[str, Any]) -> str:
    """Returns a remark in brackets on a lidar's scans that are left out; an empty text if none are left out.

    Args:
        dataset: entry `dataset` of a summary.
    """
    used, left_out = dataset.get("revolutions"), dataset.get("left_out")
    if not used or not left_out:
        return ""
    return f" (of {used + left_out}; the others are left out, since the lidar had hardly moved)"


def explain_rest(used: int, left_out: int, least: int) -> list[str]:
    """Returns a list with a sentence that says how many of a lidar's scans are left out, why, and what to do about it.

    Args:
        used: number of scans that are used.
        left_out: number of scans that are left out.
        least: number of scans that are needed. If so many are used, or none is left out, the list is empty.
    """
    if not left_out or used >= least:
        return []
    left = f"{left_out} of {used + left_out} scans are left out, since the lidar had hardly moved"
    return [f"{left}: give a recording, or a stretch of it, in which it moves farther"]


def list_outcomes(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Returns the sentences of an audit beside its verdict, as pairs (name, sentence).

    The sentences say whether stated covariances are right, and what mending did; each is left out if there is none.

    Args:
        summary: content of audit.json.
    """
    covariances, mended = (summary.get(name) or {} for name in ("covariances", "mended"))
    sentences = {"covariances": covariances.get("statement"), "mended": mended.get("sentence")}
    return [(name, sentence) for name, sentence in sentences.items() if sentence]


def describe_last_pose(last: Mapping[str, Any] | None) -> str:
    """Describes the uncertainty of a run's last pose in words.

    Args:
        last: entry `last_pose` of the run's summary.
    """
    if last is None:
        return "its uncertainty is not known"
    along, across, yaw = last["sigma_along_m"], last["sigma_across_m"], math.degrees(last["sigma_yaw_rad"])
    sure = f"± {along:.2g} m along, {across:.2g} m across, {yaw:.2g} deg heading (one sigma, seen from the first pose)"
    if last["prior_share"] < _WORTH_SAYING:
        return sure
    share = f"{last['prior_share']:.0%} of the variance of its position"
    return f"{sure}; {share} come from the scale of the ranges, which is stated or assumed (a prior), not measured"


def describe_delay(delay_s: float) -> str:
    """Describes a delay of a clock [s] in words, such as `0.50 s late`; a negative delay is early."""
    return f"{abs(delay_s):.2f} s {'late' if delay_s >= 0.0 else 'early'}"


_WORTH_SAYING = 0.1  # smaller shares of a prior in a variance are not mentioned
_NAMES = {"gyroscope": "the gyroscope", "gnss": "GNSS"}


def list_sensor_notes(summary: Mapping[str, Any]) -> list[str]:
    """Returns notes on the Doppler shift, the sensors in use, the mount and the ranges, and any warning of `_doubt_sensors`.

    Notes on a sensor that is not used are shown elsewhere, as warnings.

    Args:
        summary: content of summary.json; it may lack the entries on sensors, mount and ranges.
    """
    sensors = summary.get("sensors") or {}
    parts = [*sensors.values(), *(summary.get(name) for name in ("mount", "range_errors", "range_scale"))]
    found = (part for part in parts if part is not None and part.get("used", True))
    used = [_NAMES[name] for name, part in sensors.items() if name in _NAMES and part and part.get("used")]
    statements = [statement for part in found for statement in part["statements"]]
    return _describe_doppler(summary) + statements + _doubt_sensors(summary, used)


def _describe_doppler(summary: Mapping[str, Any]) -> list[str]:
    """Returns a note, in a list, on the Doppler shift that a run measured; empty if the shift was stated or is unknown."""
    beta, sigma = summary.get("doppler_beta"), summary.get("doppler_sigma")
    if not beta or not sigma:
        return []
    shift = f"{beta:.4f} ± {sigma:.4f} m of range per m/s of closing speed"
    causes = "a wrong length of range bins or a range offset may contribute to this value"
    return [f"the Doppler shift, as psi measured it, is {shift}; {causes}"]


def _doubt_sensors(summary: Mapping[str, Any], used: Sequence[str]) -> list[str]:
    """Returns a warning, in a list, that sensors may have made the map worse; empty without such a suspicion.

    Sensors are suspected if the audit does not pass and psi was lower (crisper) before the sensors were added.

    Args:
        summary: content of summary.json.
        used: names of the sensors in use, for the warning.
    """
    psi = summary.get("psi") or {}
    before, after = psi.get("per_point_odometry"), psi.get("per_point_optimised")
    passed = (summary.get("verdict") or {}).get("status") == "pass"
    if not used or passed or before is None or after is None or after <= before:
        return []
    psi_of_both = f"psi per point is {before:.4f} before optimisation and {after:.4f} with the sensors"
    return [f"{psi_of_both}: the sensors may bend the map; compare it with a run without {' and '.join(used)}"]
