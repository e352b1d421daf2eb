"""What more workers gain: a batch of short runs on a cluster, and the calls of one run handed out by simulation."""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, TypeVar

from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label
from bench.commands import batch
from bench.recordings import simulate_city, simulate_short_city

from mqslam.commands.run import run
from mqslam.commands.work import Work
from mqslam.config import Config
from mqslam.core.engine import ignore_result, ignore_start
from mqslam.execution.cluster import choose_group_size, connect

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")

_SHORT = 11  # seed of a city of a minute
_HOUR_S = 3600.0
_CALLS = 500  # by which handing out a call is timed


def _measure_cluster(out: Path) -> list[Row]:
    data = simulate_short_city("kind", _SHORT)
    runs = out / "runs.yaml"
    lines = [f"  - {{data: {data}, name: run{k}, odometry: none}}" for k in range(4)]
    runs.write_text("\n".join(["runs:", *lines, ""]), encoding="utf-8")
    spent: list[float] = []
    rows = []
    for workers in (1, 2):
        begin = time.perf_counter()
        batch(runs, out / f"workers{workers}", "--cluster", f"local:{workers}")
        spent.append(time.perf_counter() - begin)
        cells = {"workers": str(workers), "seconds": spent[-1], "share": spent[-1] / spent[0]}
        rows.append(Row(cells, judged=workers > 1))
    return rows


def _measure_workers(out: Path) -> list[Row]:
    short, long = simulate_short_city("hard", _SHORT), simulate_city("hard", 2)
    first = _time_calls(short, out / "first")  # which loads modules and kernels, as every command does once
    again, whole = _time_calls(short, out / "again"), _time_calls(long, out / "whole")
    per_second = (whole.alone_s - again.alone_s) / (whole.duration_s - again.duration_s)
    alone_s = first.alone_s - again.alone_s + whole.alone_s + per_second * (_HOUR_S - whole.duration_s)
    parts = round(_HOUR_S / whole.duration_s)  # of an hour, each like this recording
    dispatch_s = _time_dispatch()

    def last(workers: int) -> float:
        return alone_s + sum(simulate_batch(parts * seconds, workers, dispatch_s) for seconds in whole.batches)

    one, rows = last(1), []
    for workers in (1, 2, 4, 8, 16, 32, 64, 128, 256):
        cells = {"seconds": last(workers), "gain": one / last(workers), "alone": alone_s / last(workers)}
        rows.append(Row({"workers": str(workers), **cells}, judged=workers == 64))
    return rows


class _Calls(NamedTuple):
    """A run: the length of its recording, what lies outside of all calls, and the calls of each map, all in seconds."""

    duration_s: float
    alone_s: float
    batches: list[list[float]]


def _time_calls(data: Path, out: Path) -> _Calls:
    """Runs a recording, tracked in segments, with an engine that makes one call after the other, in processor time."""
    engine, config = StopwatchEngine(), Config()
    config = config.model_copy(update={"tracker": config.tracker.model_copy(update={"segment_scans": 300})})
    begin = time.process_time()
    result = run(data, out, odometry="none", config=config, work=Work(engine=engine))
    alone_s = time.process_time() - begin - sum(map(sum, engine.batches))
    return _Calls(result.summary["dataset"]["duration_s"], alone_s, engine.batches)


def _time_dispatch() -> float:
    """Returns how long a cluster of this machine takes to hand out one call that does nothing [s]."""
    with connect("local:2") as engine:
        engine.map(_do_nothing, None, range(20))
        begin = time.perf_counter()
        engine.map(_do_nothing, None, range(_CALLS))
        return (time.perf_counter() - begin) / _CALLS


def _do_nothing(shared: None, item: int) -> None:
    """Does nothing."""


@dataclass
class StopwatchEngine:
    """An engine that makes one call after the other in this process, and notes the processor time that each takes.

    Attributes:
        batches: the seconds of the calls of each `map`, in the order of the run.
    """

    jobs: int = 1
    batches: list[list[float]] = field(default_factory=list)

    def map(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R], None] = ignore_result,
    ) -> list[R]:
        """Calls the function as `Engine.map` does."""
        results, seconds = [], list[float]()
        self.batches.append(seconds)
        for number, item in enumerate(items, 1):
            begin = time.process_time()
            results.append(function(shared, item))
            seconds.append(time.process_time() - begin)
            done(number, results[-1])
        return results

    def start(self, function: Callable[[S, T], R], shared: S, item: T) -> AbstractContextManager[None]:
        """Leaves the call to whoever asks for it."""
        return nullcontext()

    def map_apart(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        done: Callable[[int, R | None], None] = ignore_result,
        started: Callable[[int], None] = ignore_start,
    ) -> list[R | None]:
        """Calls the function as `Engine.map_apart` does; nothing here asks for the starts of calls."""
        return [*self.map(function, shared, items, done)]


def simulate_batch(seconds: Sequence[float], workers: int, dispatch_s: float) -> float:
    """Returns how long calls take on workers that each take the next one as soon as they are free [s].

    Args:
        seconds: of each call, in the order in which they are handed out, in groups as a cluster takes them.
        workers: how many there are.
        dispatch_s: what handing out one group takes, one after the other [s].
    """
    size = choose_group_size(len(seconds), workers)
    groups = [sum(seconds[begin : begin + size]) for begin in range(0, len(seconds), size)]
    free = [0.0] * min(workers, max(len(groups), 1))
    for number, lasts in enumerate(groups, 1):
        heapq.heappush(free, max(heapq.heappop(free), number * dispatch_s) + lasts)
    return max(free)


BENCHMARKS = {
    "cluster": Benchmark(
        study=True,
        what="A batch of four runs of a minute each on a local cluster, the whole command.",
        data="simulated",
        seeds=(_SHORT,),
        columns=(
            label("workers", "workers"),
            Column("seconds", "time [s]", "{:.0f}"),
            Column("share", "of one worker's time", "{:.2f}", Goal.FAST),
        ),
        measure=_measure_cluster,
        bounds=(Bound("share", {"workers": "2"}, most=0.72),),
    ),
    "workers": Benchmark(
        what="An hour of radar in one piece, tracked in segments of 300 scans: "
        "its calls as they took on one core, simulated.",
        data="simulated",
        seeds=(2, _SHORT),
        columns=(
            label("workers", "workers"),
            Column("seconds", "time [s]", "{:.0f}"),
            Column("gain", "times faster than one", "{:.1f}", Goal.HIGH),
            Column("alone", "of it outside of all calls", "{:.0%}"),
        ),
        measure=_measure_workers,
        bounds=(Bound("gain", {"workers": "64"}, least=3.0),),
    ),
}
