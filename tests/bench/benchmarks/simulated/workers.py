"""How far more workers make one run faster: its calls as they took on one core, handed out to more workers by simulation."""

from __future__ import annotations

import time
from pathlib import Path
from typing import NamedTuple

from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label
from bench.measuring.recordings import simulate_city, simulate_short_city
from bench.measuring.scheduling import StopwatchEngine, simulate_batch

from mqslam.commands.run import run
from mqslam.commands.work import Work
from mqslam.config import Config
from mqslam.execution.cluster import connect

_SEED, _SHORT_SEED = 2, 11
_HOUR_S = 3600.0
_SEGMENT_SCANS = 300  # of the tracker: as a whole, a recording is tracked by one worker in each direction of time
_WORKERS = (1, 2, 4, 8, 16, 32, 64, 128, 256)
_CALLS = 500  # by which handing out a call is timed


class _Timed(NamedTuple):
    """A run: the length of its recording, what lies outside of all calls, and the calls of each map, all in seconds."""

    duration_s: float
    alone_s: float
    batches: list[list[float]]


def _measure(out: Path) -> list[Row]:
    short, long = simulate_short_city("hard", _SHORT_SEED), simulate_city("hard", _SEED)
    first = _time_run(short, out / "first")  # which loads modules and kernels, as every command does once
    again, whole = _time_run(short, out / "again"), _time_run(long, out / "whole")
    per_second = (whole.alone_s - again.alone_s) / (whole.duration_s - again.duration_s)
    alone_s = first.alone_s - again.alone_s + whole.alone_s + per_second * (_HOUR_S - whole.duration_s)
    parts = round(_HOUR_S / whole.duration_s)  # of an hour, each like this recording
    dispatch_s = _time_dispatch()

    def last(workers: int) -> float:
        return alone_s + sum(simulate_batch(parts * seconds, workers, dispatch_s) for seconds in whole.batches)

    one = last(1)
    return [
        Row(
            {
                "workers": str(workers),
                "seconds": last(workers),
                "gain": one / last(workers),
                "alone": alone_s / last(workers),
            },
            judged=workers == 64,
        )
        for workers in _WORKERS
    ]


def _time_run(data: Path, out: Path) -> _Timed:
    """Runs a recording with an engine that makes one call after the other, in processor time."""
    engine, config = StopwatchEngine(), Config()
    config = config.model_copy(update={"tracker": config.tracker.model_copy(update={"segment_scans": _SEGMENT_SCANS})})
    begin = time.process_time()
    result = run(data, out, odometry="none", config=config, work=Work(engine=engine))
    alone_s = time.process_time() - begin - sum(map(sum, engine.batches))
    return _Timed(result.summary["dataset"]["duration_s"], alone_s, engine.batches)


def _time_dispatch() -> float:
    """Returns how long a cluster of this machine takes to hand out one call that does nothing [s]."""
    with connect("local:2") as engine:
        engine.map(_do_nothing, None, range(20))
        begin = time.perf_counter()
        engine.map(_do_nothing, None, range(_CALLS))
        return (time.perf_counter() - begin) / _CALLS


def _do_nothing(shared: None, item: int) -> None:
    """Does nothing."""


BENCHMARK = Benchmark(
    what="An hour of radar in one piece, tracked in segments of 300 scans: its calls as they took on one core, simulated.",
    data="simulated",
    seeds=(_SEED, _SHORT_SEED),
    columns=(
        label("workers", "workers"),
        Column("seconds", "time [s]", "{:.0f}"),
        Column("gain", "times faster than one", "{:.1f}", Goal.HIGH),
        Column("alone", "of it outside of all calls", "{:.0%}"),
    ),
    measure=_measure,
    bounds=(Bound("gain", {"workers": "64"}, least=3.0),),
)
