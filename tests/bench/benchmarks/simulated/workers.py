"""How far more workers make one run faster: its calls as they took on one core, handed out to more workers by simulation."""

from __future__ import annotations

import time
from pathlib import Path

from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label
from bench.measuring.recordings import simulate_city
from bench.measuring.scheduling import StopwatchEngine, simulate_batch

from mqslam.commands.run import run
from mqslam.commands.work import Work
from mqslam.config import Config
from mqslam.execution.cluster import connect

_SEED = 2
_HOUR_S = 3600.0
_SEGMENT_SCANS = 300  # of the tracker: as a whole, a recording is tracked by one worker in each direction of time
_WORKERS = (1, 2, 4, 8, 16, 32, 64, 128, 256)
_CALLS = 500  # by which handing out a call is timed


def _measure(out: Path) -> list[Row]:
    data, engine = simulate_city("hard", _SEED), StopwatchEngine()
    config = Config()
    config = config.model_copy(update={"tracker": config.tracker.model_copy(update={"segment_scans": _SEGMENT_SCANS})})
    begin = time.perf_counter()
    result = run(data, out / data.name, odometry="none", config=config, work=Work(engine=engine))
    whole_s = time.perf_counter() - begin
    parts = round(_HOUR_S / result.summary["dataset"]["duration_s"])  # of an hour, each like this recording
    dispatch_s = _time_dispatch()
    alone_s = whole_s - sum(map(sum, engine.batches))

    def last(workers: int) -> float:
        batches = sum(simulate_batch(parts * seconds, workers, dispatch_s) for seconds in engine.batches)
        return parts * alone_s + batches

    one = last(1)
    return [
        Row(
            {
                "workers": str(workers),
                "seconds": last(workers),
                "gain": one / last(workers),
                "alone": parts * alone_s / last(workers),
            },
            judged=workers == 64,
        )
        for workers in _WORKERS
    ]


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
    seeds=(_SEED,),
    columns=(
        label("workers", "workers"),
        Column("seconds", "time [s]", "{:.0f}"),
        Column("gain", "times faster than one", "{:.1f}", Goal.HIGH),
        Column("alone", "of it outside of all calls", "{:.0%}"),
    ),
    measure=_measure,
    bounds=(Bound("gain", {"workers": "64"}, least=3.0),),
)
