"""The first stage of a run: every revolution read, detected and released."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

from mqslam.artefacts import drop_fixed
from mqslam.detector import DetectorConfig, detect
from mqslam.returns import Returns, Window
from mqslam.stream import RadarStream

Progress = Callable[[str, int, int], None]  # stage, done, total
_CHUNK = 40  # revolutions a worker takes at a time
_WORTH_A_POOL = 200  # starting workers costs more than this many revolutions


@dataclass(frozen=True, slots=True)
class Detected:
    """The returns of a stretch of revolutions and what they cost."""

    returns: list[Returns]
    read_s: float
    detect_s: float


def detect_stretch(stream: RadarStream, config: DetectorConfig, start: int, stop: int) -> Detected:
    """Read and detect the revolutions start <= k < stop.

    Raises:
        DataError: a revolution that cannot be read.
    """
    found: list[Returns] = []
    read_s, detect_s = 0.0, 0.0
    mark = time.perf_counter()
    for revolution in stream.revolutions(start, stop):
        read = time.perf_counter()
        found.append(detect(revolution, stream.range_resolution, config))
        done = time.perf_counter()
        read_s, detect_s, mark = read_s + read - mark, detect_s + done - read, done
    return Detected(found, read_s, detect_s)


def detect_all(stream: RadarStream, config: DetectorConfig, jobs: int, progress: Progress) -> tuple[list[Window], Detected]:
    """One window of returns per revolution; the same for any number of jobs.

    Raises:
        DataError: a revolution that cannot be read.
    """
    total = len(stream)
    spans = [(k, min(k + _CHUNK, total)) for k in range(0, total, _CHUNK)]
    parts: list[Detected] = []
    if jobs == 1 or total < _WORTH_A_POOL:
        for begin, end in spans:
            parts.append(detect_stretch(stream, config, begin, end))
            progress("detect", end, total)
    else:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            pending = [pool.submit(detect_stretch, stream, config, begin, end) for begin, end in spans]
            try:
                for (_, end), future in zip(spans, pending, strict=True):
                    parts.append(future.result())
                    progress("detect", end, total)
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
    returns = drop_fixed([r for part in parts for r in part.returns])
    cost = Detected(returns, sum(p.read_s for p in parts), sum(p.detect_s for p in parts))
    return windows_of(stream, returns), cost


def windows_of(stream: RadarStream, returns: list[Returns]) -> list[Window]:
    """A window per revolution: from its start to the next one's, or one turn long before a gap and at the end."""
    starts = stream.start_times
    ends = [*starts[1:], (stream.end_us - stream.start_us) * 1e-6]
    longest = 1.5 * stream.period_s
    return [
        Window(float(t0), float(t1 if t1 - t0 <= longest else t0 + stream.period_s), found)
        for t0, t1, found in zip(starts, ends, returns, strict=True)
    ]
