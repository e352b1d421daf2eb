"""The first stage of a radar's run: detects the returns of polar scans, and measures velocities from alternating chirps."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from dataclasses import replace
from socket import gethostname

import numpy as np

from mqslam.config import DetectorConfig
from mqslam.core.recording import PolarScan, Recording
from mqslam.core.scans import PeakCounts, Returns, Scan, Scans, ScanStore
from mqslam.core.velocity import Detected, Outcome, Velocities
from mqslam.core.wording import count_of, is_or_are
from mqslam.detection.artefacts import drop_cells, find_fixed
from mqslam.detection.detector import detect_and_count
from mqslam.detection.velocity_fit import measure_velocity
from mqslam.errors import DataError
from mqslam.execution.kept import describe_kept_stretch
from mqslam.execution.runner import Runner

# A recording is refused if more than this share of its polar scans cannot be read.
_MOST_UNREAD = 0.5
_CHUNK = 40  # polar scans that a worker takes at a time; no result depends on this number
# Azimuths of one turn that are farther apart than this [rad] are in degrees, and azimuths that are measured longer than this
# [s] before or after their turn are stamped in another unit or by another clock. Both are far beyond what damage does.
_WIDEST, _FARTHEST_S = 100.0, 60.0
_LISTED = 3  # number of files that the warning of unread polar scans names

_log = logging.getLogger(__name__)


def detect_stretch(
    recording: Recording,
    config: DetectorConfig,
    start: int,
    stop: int,
    *,
    strict: bool = True,
    with_velocities: bool = False,
) -> Detected:
    """Reads the polar scans start <= k < stop, detects their returns and, if asked for, measures the sensor's velocities.

    Args:
        recording: the recording.
        config: settings of the detector.
        start: index of the first polar scan.
        stop: index of the last polar scan, plus one.
        strict: whether a polar scan that cannot be read is an error; else it becomes a scan without returns.
        with_velocities: whether each polar scan measures the sensor's velocity, or states why it has none.

    Returns:
        The returns of each polar scan, and the other results; `velocities` is None unless asked for.

    Raises:
        DataError: a polar scan cannot be read, and either `strict` is set or the recording does not exist on this machine;
            or the arrays of a polar scan do not have the shapes, units or times that `PolarScan` states.
    """
    scans: list[Returns] = []
    velocities: list[Velocities] = []
    unread: dict[int, DataError] = {}
    counts = PeakCounts()
    stretch = slice(start, stop)
    middles = (recording.stamps_us[stretch] - recording.start_us + 0.5 * recording.turns_us[stretch]) * 1e-6
    read_s, detect_s = 0.0, 0.0
    mark = time.perf_counter()
    for k, polar_scan in read_polar_scans(recording, start, stop):
        read = time.perf_counter()
        if not isinstance(polar_scan, DataError):
            _check_polar_scan(recording, k, polar_scan)
            returns, counted = detect_and_count(polar_scan, recording.range_resolution, config, recording.range_offset)
            scans.append(returns)
            counts += counted
            if with_velocities:
                velocities.append(measure_velocity(polar_scan, recording.range_resolution, float(middles[k - start])))
        elif strict:
            raise polar_scan
        elif not recording.path.exists():  # this worker can reach none of the polar scans
            raise DataError(recording.path, f"does not exist on {gethostname()}", "put it on every machine that reads it")
        else:
            unread[k] = polar_scan.with_traceback(None)
            scans.append(Returns.none())
            velocities.append(Velocities.of_scan(float(middles[k - start]), Outcome.UNREAD))
        done = time.perf_counter()
        read_s, detect_s, mark = read_s + read - mark, detect_s + done - read, done
    return Detected(scans, unread, read_s, detect_s, counts, Velocities.join(velocities) if with_velocities else None)


def read_polar_scans(recording: Recording, start: int, stop: int) -> Iterator[tuple[int, PolarScan | DataError]]:
    """Yields (k, polar scan k) for start <= k < stop; in place of a polar scan that cannot be read, the error."""
    k = start
    while k < stop:
        try:  # reading ends with the first error, and begins again after it
            for polar_scan in recording.polar_scans(k, stop):
                yield k, polar_scan
                k += 1
        except DataError as error:
            yield k, error
            k += 1


def detect_all(
    recording: Recording,
    config: DetectorConfig,
    runner: Runner | None = None,
    *,
    strict: bool = False,
    with_velocities: bool = False,
) -> tuple[Scans, Detected]:
    """Detects the returns of all polar scans, and drops the returns that repeat in the sensor's frame.

    Args:
        recording: the recording.
        config: settings of the detector.
        runner: reads polar scans and detects their returns on its workers; None does both in this process.
        strict: whether a single polar scan that cannot be read is an error; else it becomes a scan without returns.
        with_velocities: whether each polar scan measures the sensor's velocity, which needs alternating chirps.

    Returns:
        The scans, and the other results as a `Detected` whose own list of returns is empty.

    Raises:
        DataError: more than half of the polar scans cannot be read, one cannot be read and `strict` is set, the recording
            does not exist on the machine of a worker, or its arrays contradict what `Recording` and `PolarScan` state.
    """
    _check_recording(recording)
    total = len(recording)
    parts = (runner or Runner()).map(
        "detect",
        _detect_span,
        (recording, config, strict, with_velocities),
        [(k, min(k + _CHUNK, total)) for k in range(0, total, _CHUNK)],
        kept=lambda span: describe_kept_stretch(*span),
        accept=lambda part: not (strict and part.unread),
        steps=lambda span: span[1] - span[0],
    )
    store, others = ScanStore(), list[Detected]()

    def take_in() -> Iterator[Returns]:
        """Stores and yields the returns of one scan after the other, and collects the other results in `others`."""
        for part in parts:
            others.append(replace(part, returns=[]))
            for returns in part.returns:
                store.append(returns)
                yield returns

    fixed = find_fixed(take_in())
    unread = {k: error for part in others for k, error in part.unread.items()}
    if len(unread) > _MOST_UNREAD * total:
        first = next(iter(unread.values()))
        problem = f"{first.problem}; {len(unread)} of {total} polar scans cannot be used"
        raise DataError(first.path, problem, first.remedy)
    scans = store.close(np.column_stack([recording.start_times, recording.end_times]))
    if fixed is not None:
        rest = ScanStore()
        for scan in scans:
            rest.append(drop_cells(scan.returns, fixed))
        scans = rest.close(scans.spans)
    _log.info("%d returns in %d polar scans, of which %d could not be read", len(scans.table), total, len(unread))
    read_s, detect_s = sum(part.read_s for part in others), sum(part.detect_s for part in others)
    counts = sum((part.counts for part in others), PeakCounts())
    velocities = _join([part.velocities for part in others if part.velocities is not None])
    detected = Detected([], unread, read_s, detect_s, counts, velocities)
    return Scans(scans, recording.start_us, recording.revolution_s), detected


def _check_recording(recording: Recording) -> None:
    """Raises DataError if the index of a recording contradicts `Recording`, since a user may have written its class."""
    stamps: object = recording.stamps_us
    turns: object = recording.turns_us
    for name, column in (("stamps_us", stamps), ("turns_us", turns)):
        if not isinstance(column, np.ndarray) or column.shape != (len(recording),) or column.dtype.kind != "i":
            given = f"{column.dtype} {column.shape}" if isinstance(column, np.ndarray) else type(column).__name__
            problem = f"its {name} must be an array ({len(recording)},) of int64, but they are {given}"
            raise DataError(recording.path, problem, "give one number of microseconds for every polar scan")
    if np.any(np.diff(recording.stamps_us) <= 0):
        k = int(np.argmax(np.diff(recording.stamps_us) <= 0)) + 1
        problem = f"its stamps_us do not increase at polar scan {k}"
        raise DataError(recording.path, problem, "give the polar scans in the order of time, each once")
    if np.any(recording.turns_us <= 0):
        k = int(np.argmax(recording.turns_us <= 0))
        problem = f"its turns_us are {recording.turns_us[k]} at polar scan {k}"
        raise DataError(recording.path, problem, "give the duration of every revolution in microseconds")
    if not 0.0 < recording.range_resolution < np.inf:
        problem = f"its range_resolution is {recording.range_resolution}"
        raise DataError(recording.path, problem, "give the length of a range bin in metres")


def _check_polar_scan(recording: Recording, k: int, polar_scan: PolarScan) -> None:
    """Raises DataError if the arrays of polar scan k contradict `PolarScan`, since a user may have written its reader."""
    times, azimuths = polar_scan.times, polar_scan.azimuths
    begin = 1e-6 * (int(recording.stamps_us[k]) - recording.start_us)
    shapes = [np.shape(column) for column in (times, azimuths, polar_scan.power, polar_scan.valid)]
    count, begins = len(polar_scan.times), [shape[:1] for shape in shapes]
    if [len(shape) for shape in shapes] != [1, 1, 2, 1] or any(shape != (count,) for shape in begins):
        problem = f"polar scan {k}: its times, azimuths, power and valid have the shapes {', '.join(map(str, shapes))}"
        raise DataError(recording.path, problem, "give (A,), (A,), (A, B) and (A,)")
    if count and not np.ptp(azimuths) <= _WIDEST:
        problem = f"polar scan {k}: its azimuths span {np.ptp(azimuths):.0f} rad"
        raise DataError(recording.path, problem, "give them in radians")
    if count and not np.abs(times - begin).max() <= _FARTHEST_S:
        problem = f"polar scan {k}: its times go from {times[0]:g} s to {times[-1]:g} s, and it begins at {begin:g} s"
        raise DataError(recording.path, problem, "give times in seconds since the recording's start")


def _join(stretches: list[Velocities]) -> Velocities | None:
    """Joins the velocities of all stretches; returns None if there are no stretches or if the chirps do not alternate."""
    velocities = Velocities.join(stretches) if stretches else None
    if velocities is None or not velocities.alternating:
        return None
    unmeasured = "".join(f"; {count} did not: {reason}" for reason, count in velocities.reasons.items())
    _log.info("%d of %d scans measured the velocity%s", np.count_nonzero(velocities.measured), len(velocities), unmeasured)
    return velocities


def _detect_span(shared: tuple[Recording, DetectorConfig, bool, bool], span: tuple[int, int]) -> Detected:
    recording, config, strict, with_velocities = shared
    return detect_stretch(recording, config, *span, strict=strict, with_velocities=with_velocities)


def warn_of_unread(unread: dict[int, DataError]) -> list[str]:
    """Returns a list of one warning about unread polar scans, given their errors by index; an empty list without errors."""
    if not unread:
        return []
    several = f"{count_of(len(unread), 'polar scan')} could not be read and {is_or_are(len(unread))} left out"
    named = [f"{error.path}: {error.problem}" for error in list(unread.values())[:_LISTED]]
    others = [f"and {len(unread) - _LISTED} more"] if len(unread) > _LISTED else []
    return [f"{several}: {', '.join(named + others)}"]


def make_scans(recording: Recording, returns: list[Returns] | None = None, begin: int = 0) -> Scans:
    """Makes one scan per polar scan. A scan lasts until the next scan starts; before a gap or at the end, for one turn.

    Args:
        recording: the recording.
        returns: the returns of each polar scan of a stretch; None makes empty scans for the whole recording.
        begin: index of the first polar scan of the stretch.
    """
    returns = [Returns.none()] * len(recording) if returns is None else returns
    stretch = slice(begin, begin + len(returns))
    spans = zip(recording.start_times[stretch].tolist(), recording.end_times[stretch].tolist(), returns, strict=True)
    scans = (Scan(t0, t1, seen) for t0, t1, seen in spans)
    return Scans(tuple(scans), recording.start_us, recording.revolution_s)
