"""Detects the returns of a recording, and checks scans that another program has made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import inf
from numbers import Integral
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from mqslam.commands.inputs import WHOLE, Span, open_radar_or_lidar
from mqslam.commands.lidar_inputs import prepare_lidar
from mqslam.commands.work import QUIET, Work, require_work
from mqslam.config import Config, ConfigSource, load_config
from mqslam.core.recording import SLOWEST_TURN_US, LidarRecording, Recording
from mqslam.core.scans import Returns, Scan, Scans, StoredScans
from mqslam.detection.stage import detect_all, warn_of_unread
from mqslam.errors import ConfigError, require_type
from mqslam.execution.runner import Runner
from mqslam.formats.recordings.derived import clip

Source: TypeAlias = Path | str | Recording | Scans
"""A recording: its path, the open recording, or the scans that were detected in it before."""
_WIDEST: Final = 4.0 * np.pi  # [rad]; the azimuths of one turn span less, whether they are wrapped or not


def detect(
    recording: Source,
    *,
    config: ConfigSource = None,
    start_s: float | None = None,
    end_s: float | None = None,
    work: Work = QUIET,
) -> Scans:
    """Detects the returns of a recording, as a run does.

    Returns that lie at the same place of the radar's own frame in most scans are left out, since they show the vehicle. The
    command `mqslam score` reads only one window and cannot leave them out, so its psi may differ from `mqslam.score`.

    For a planar lidar, the result holds the scans as a run uses them, not as they were measured: scans are left out where
    odometry shows no motion, and the returns are points at equal distances along the surfaces that the lidar saw.
    `mqslam.open_recording(path).scans` holds the ranges as they were measured.

    Args:
        recording: a recording's path, or the open recording. `Scans` that another program has made are checked and returned.
        config: a `Config`, a dict of the settings that differ, such as `{"detector": {"threshold": 60}}`, the path of a YAML
            file, or the name of a shipped configuration; None takes the defaults.
        start_s: scans that begin before this time are left out [s since the recording's start]; None leaves out none.
        end_s: scans that begin at this time or later are left out [s since the recording's start]; None leaves out none.
        work: the engine that does the computations, and the functions that get progress and notes.

    Returns:
        The scans. `scans[k].returns` holds the ranges [m], azimuths [rad], times [s] and intensities of scan k, and
        `scans[k:n]` is a window for `mqslam.score`.

    Raises:
        ConfigError: a setting or the scans are wrong, the time from `start_s` to `end_s` holds no scan, or `start_s` or
            `end_s` is given for scans.
        DataError: the recording cannot be used.

    Example:
        >>> scans = mqslam.detect("drive", config={"detector": {"threshold": 60}})  # doctest: +SKIP
    """
    require_work(work)
    runner = Runner(work.engine, work.progress)
    return read_scans(recording, load_config(config), runner, work.tell, (start_s, end_s))[0]


def read_scans(
    recording: Source, settings: Config, runner: Runner, tell: Callable[[str], None], span: Span = WHOLE
) -> tuple[Scans, str]:
    """Returns the scans of a recording, and the remedy to name if they hold too few returns; the remedy may be "".

    Args:
        recording: the path of a recording, an open recording, or scans.
        settings: all settings.
        runner: detects the returns in a radar's polar scans.
        tell: called with every note for the user about the data.
        span: begin and end of the part that is used [s since the recording's start]; None takes the recording's own.

    Raises:
        ConfigError: the scans are not what `Scans` states, the span holds no scan, or a span is given for scans.
        DataError: the recording cannot be used.
    """
    if isinstance(recording, Path | str):
        recording = open_radar_or_lidar(Path(recording), None, None, settings)
    given: object = recording  # a caller without a type checker may give anything
    if not isinstance(given, Recording | Scans):
        kind = type(given).__name__
        raise ConfigError(f"a recording is a path, an open recording or mqslam.Scans, not a {kind}; put scans into Scans")
    if isinstance(recording, Scans):
        if span != WHOLE:
            raise ConfigError("scans: only a recording is cut by start and end; cut scans by number, as scans[first:after]")
        return check_scans(recording), ""
    recording = clip(recording, *span)
    for note in (*recording.notes, *recording.faults):
        tell(note)
    if isinstance(recording, LidarRecording):
        return prepare_lidar(recording, settings)[0].scans, ""
    scans, detected = detect_all(recording, settings.detector, runner)
    for warning in warn_of_unread(detected.unread):
        tell(warning)
    return scans, detected.counts.remedy


def check_scans(scans: Scans) -> Scans:
    """Checks that scans are what `Scans`, `Scan` and `Returns` state, since another program may have made them.

    The constructors do not check this, because the stages make many returns, and checks would slow them down.

    Returns:
        The scans, with returns as contiguous arrays of float64.

    Raises:
        ConfigError: the duration of a revolution is impossible, the scans are not in order, or the returns of a scan are not
            finite, have negative ranges or azimuths in degrees, are not in order, or lie outside of the scan's time.
    """
    require_type(scans.start_us, Integral, "start_us of scans", "a whole number of microseconds")
    longest = inf if scans.unit_m is not None else SLOWEST_TURN_US * 1e-6  # a lidar may be at rest between its scans
    if not 0.0 < scans.revolution_s <= longest or scans.revolution_s == inf:
        problem = f"a revolution of {scans.revolution_s:g} s is impossible"
        raise ConfigError(f"scans: {problem}; give its usual duration in seconds, such as 0.25")
    starts = scans.start_times
    if np.any(np.diff(starts) <= 0.0):
        k = int(np.argmax(np.diff(starts) <= 0.0)) + 1
        raise ConfigError(
            f"scans: scan {k} does not begin after scan {k - 1}; give the scans in the order of time, each once"
        )
    for k, scan in enumerate(scans):
        if fault := _find_fault(scan, 0.5 * scans.revolution_s):
            raise ConfigError(f"scans: the returns of scan {k} {fault}")
    return _convert_returns(scans)


def _convert_returns(scans: Scans) -> Scans:
    """Returns scans with returns as contiguous arrays of float64: for other arrays, all kernels would be compiled anew."""
    if isinstance(scans.scans, StoredScans) or all(
        column.dtype == np.float64 and column.flags.c_contiguous for scan in scans for column in scan.returns.columns
    ):
        return scans
    even = (
        replace(scan, returns=Returns(*(np.ascontiguousarray(column, np.float64) for column in scan.returns.columns)))
        for scan in scans
    )
    return replace(scans, scans=tuple(even))


def _find_fault(scan: Scan, slack_s: float) -> str:
    """Describes the fault in the returns of a scan, and what to do about it, in words; "" if there is no fault.

    Args:
        scan: the scan.
        slack_s: time [s] by which returns may lie outside of the scan, for programs that round its start and end.
    """
    ranges, azimuths, times = scan.returns.ranges, scan.returns.azimuths, scan.returns.times
    if any(column.dtype.kind not in "fiu" for column in scan.returns.columns):
        return "are not made of numbers; give arrays of float64"
    if not len(ranges):
        return ""
    if not all(np.isfinite(column).all() for column in scan.returns.columns):
        return "hold numbers that are not finite; leave these returns out"
    if ranges.min() < 0.0:
        return "have negative ranges; give distances from the sensor in metres"
    if np.ptp(azimuths) > _WIDEST:
        return f"have azimuths that span {np.ptp(azimuths):.0f} rad; give them in radians, of one turn per scan"
    if np.any(np.diff(times) < 0.0):
        return "are not ordered by time; sort them"
    if times[0] < scan.t0 - slack_s or times[-1] > scan.t1 + slack_s:
        span = f"from {times[0]:g} s to {times[-1]:g} s, and the scan from {scan.t0:g} s to {scan.t1:g} s"
        return f"have times {span}; give both in seconds since the recording's start"
    return ""
