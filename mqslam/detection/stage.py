"""The first stage of a run: every polar scan is read, its returns are detected, and its power is released."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from socket import gethostname

import numpy as np
from numpy.typing import NDArray

from mqslam.config import DetectorConfig
from mqslam.core.recording import PolarScan, Recording
from mqslam.core.scans import Detected, PeakCounts, Returns, Scan, Scans, ScanStore, StoredScans
from mqslam.detection.artefacts import drop_cells, find_fixed
from mqslam.detection.detector import detect_and_count
from mqslam.errors import DataError
from mqslam.execution.kept import describe_kept_stretch
from mqslam.execution.runner import Runner

_log = logging.getLogger(__name__)


_CHUNK = 40  # polar scans that a worker takes at a time: no result depends on it
_LISTED = 3  # files that a warning of unread polar scans names


def detect_stretch(recording: Recording, config: DetectorConfig, start: int, stop: int, *, strict: bool = True) -> Detected:
    """Reads the polar scans start <= k < stop and detects their returns.

    Args:
        recording: the recording.
        config: settings.
        start: number of the first polar scan.
        stop: number of the first polar scan after the stretch.
        strict: whether a polar scan that cannot be read is an error, rather than one without returns.

    Raises:
        DataError: a polar scan cannot be read, if strict, or the whole recording cannot.
    """
    scans: list[Returns] = []
    unread: dict[int, DataError] = {}
    counts = PeakCounts()
    read_s, detect_s = 0.0, 0.0
    mark = time.perf_counter()
    for k, polar_scan in read_polar_scans(recording, start, stop):
        read = time.perf_counter()
        if not isinstance(polar_scan, DataError):
            returns, counted = detect_and_count(polar_scan, recording.range_resolution, config)
            scans.append(returns)
            counts += counted
        elif strict:
            raise polar_scan
        elif not recording.path.exists():  # all of them are out of reach of this worker
            raise DataError(recording.path, f"is not there on {gethostname()}", "put it on every machine that reads it")
        else:
            unread[k] = polar_scan.with_traceback(None)
            scans.append(Returns.none())
        done = time.perf_counter()
        read_s, detect_s, mark = read_s + read - mark, detect_s + done - read, done
    return Detected(scans, unread, read_s, detect_s, counts)


def read_polar_scans(recording: Recording, start: int, stop: int) -> Iterator[tuple[int, PolarScan | DataError]]:
    """Yields the polar scans start <= k < stop, each with its number, or why it cannot be read."""
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
    recording: Recording, config: DetectorConfig, runner: Runner | None = None, *, strict: bool = False
) -> tuple[Scans, Detected]:
    """Returns one scan per polar scan, empty where it cannot be read, and what was detected.

    Args:
        recording: the recording.
        config: settings of the detector.
        runner: where polar scans are read and detected; None does it here, one after the other.
        strict: whether one polar scan that cannot be read is an error.

    Raises:
        DataError: over half of the polar scans cannot be read, or one if strict.
    """
    total = len(recording)
    parts = (runner or Runner()).map(
        "detect",
        _detect_span,
        (recording, config, strict),
        [(k, min(k + _CHUNK, total)) for k in range(0, total, _CHUNK)],
        kept=lambda span: describe_kept_stretch(*span),
        accept=lambda part: not (strict and part.unread),
        steps=lambda span: span[1] - span[0],
    )
    store, unread, counts = ScanStore(), dict[int, DataError](), PeakCounts()
    read_s, detect_s = 0.0, 0.0

    def take_in() -> Iterator[Returns]:
        """Stores and yields the returns of one scan after the other."""
        nonlocal counts, read_s, detect_s
        for part in parts:
            unread.update(part.unread)
            counts, read_s, detect_s = counts + part.counts, read_s + part.read_s, detect_s + part.detect_s
            for returns in part.returns:
                store.append(returns)
                yield returns

    fixed = find_fixed(take_in(), config)
    if len(unread) > config.most_unread * total:
        first = next(iter(unread.values()))
        raise DataError(first.path, f"{first.problem}, like {len(unread)} of {total} polar scans", first.remedy)
    scans = store.close(np.column_stack([recording.start_times, recording.end_times]))
    if fixed is not None:
        scans = _drop_cells(scans, fixed, config)
    _log.info("%d returns in %d polar scans, %d of them unread", len(scans.table), total, len(unread))
    return Scans(scans, recording.start_us, recording.revolution_s), Detected([], unread, read_s, detect_s, counts)


def _drop_cells(scans: StoredScans, fixed: NDArray[np.bool_], config: DetectorConfig) -> StoredScans:
    """Returns scans without the returns in fixed cells."""
    store = ScanStore()
    for scan in scans:
        store.append(drop_cells(scan.returns, fixed, config))
    return store.close(scans.spans)


def _detect_span(shared: tuple[Recording, DetectorConfig, bool], span: tuple[int, int]) -> Detected:
    recording, config, strict = shared
    return detect_stretch(recording, config, *span, strict=strict)


def warn_of_unread(unread: dict[int, DataError]) -> list[str]:
    """Returns a warning of the polar scans that could not be read, by number: one line, or none."""
    if not unread:
        return []
    several = "1 polar scan" if len(unread) == 1 else f"{len(unread)} polar scans"
    named = [f"{error.path}: {error.problem}" for error in list(unread.values())[:_LISTED]]
    others = [f"and {len(unread) - _LISTED} more"] if len(unread) > _LISTED else []
    return [f"{several} could not be read and {'is' if len(unread) == 1 else 'are'} left out: {', '.join(named + others)}"]


def make_scans(recording: Recording, returns: list[Returns] | None = None, begin: int = 0) -> Scans:
    """Returns a scan per polar scan: from its start to the next one's, or one turn long before a gap and at the end.

    Args:
        recording: the recording.
        returns: of each polar scan of a stretch; None takes the whole recording and leaves the scans empty.
        begin: number of the first polar scan of the stretch.
    """
    returns = [Returns.none()] * len(recording) if returns is None else returns
    stretch = slice(begin, begin + len(returns))
    spans = zip(recording.start_times[stretch].tolist(), recording.end_times[stretch].tolist(), returns, strict=True)
    scans = (Scan(t0, t1, seen) for t0, t1, seen in spans)
    return Scans(tuple(scans), recording.start_us, recording.revolution_s)
