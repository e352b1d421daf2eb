"""The first stage of a run: every revolution read, detected and released."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Protocol

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


class Store(Protocol):
    """Keeps the returns of stretches of revolutions, so that a run can be resumed."""

    def returns(self, begin: int, end: int) -> list[Returns] | None:
        """The returns of the revolutions begin <= k < end, if they were kept."""
        ...

    def keep_returns(self, begin: int, end: int, returns: Sequence[Returns]) -> None:
        """Keep the returns of a stretch of revolutions."""
        ...


def detect_all(
    stream: RadarStream, config: DetectorConfig, jobs: int, progress: Progress, store: Store | None = None
) -> tuple[list[Window], Detected]:
    """One window of returns per revolution; the same for any number of jobs.

    Args:
        stream: the recording.
        config: settings.
        jobs: processes that read and detect.
        progress: called as stretches are done.
        store: where stretches are kept, and looked for first.

    Raises:
        DataError: a revolution that cannot be read.
    """
    total = len(stream)
    spans = [(k, min(k + _CHUNK, total)) for k in range(0, total, _CHUNK)]
    parts: dict[int, Detected] = {}
    for begin, end in spans:
        kept = store.returns(begin, end) if store else None
        if kept is not None:
            parts[begin] = Detected(kept, 0.0, 0.0)

    def done(begin: int, end: int, found: Detected) -> None:
        parts[begin] = found
        if store:
            store.keep_returns(begin, end, found.returns)
        progress("detect", sum(len(part.returns) for part in parts.values()), total)

    missing = [(begin, end) for begin, end in spans if begin not in parts]
    if jobs == 1 or total < _WORTH_A_POOL:
        for begin, end in missing:
            done(begin, end, detect_stretch(stream, config, begin, end))
    else:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            pending = [pool.submit(detect_stretch, stream, config, begin, end) for begin, end in missing]
            try:
                for (begin, end), future in zip(missing, pending, strict=True):
                    done(begin, end, future.result())
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
    returns = drop_fixed([r for begin, _ in spans for r in parts[begin].returns])
    cost = Detected(returns, sum(p.read_s for p in parts.values()), sum(p.detect_s for p in parts.values()))
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
