"""Detection and front ends in processor time, on the same returns, against KISS-ICP's own registration of them."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label
from bench.measuring.commands import FRONT_ENDS, OURS
from bench.measuring.recordings import simulate_short_city
from bench.measuring.registration import register

from mqslam.config import Config
from mqslam.core.frontend import Context, measure_motions
from mqslam.detection.stage import detect_stretch, make_scans
from mqslam.formats.recordings import open_recording

_SEED = 11  # of a drive that `heading` measures too
_ROUNDS = 3
_REGISTRATION = "KISS-ICP's register_frame"


def _measure(out: Path) -> list[Row]:
    return [row for world in ("kind", "hard") for row in _measure_world(world)]


def _measure_world(world: str) -> list[Row]:
    """Runs all parts in turn, several times, so that other work on the machine slows each of them alike."""
    recording, config = open_recording(simulate_short_city(world, _SEED)), Config()
    scans = make_scans(recording, detect_stretch(recording, config.detector, 0, len(recording)).returns)
    context = Context(config, recording.revolution_s, recording.start_us, None, 0.0)

    def run_front_end(name: str) -> Callable[[], object]:
        return lambda: list(measure_motions(name, context, scans))

    parts: dict[str, Callable[[], object]] = {shown: run_front_end(name) for name, shown in FRONT_ENDS.items()}
    parts[_REGISTRATION] = lambda: register(scans)
    parts["reading and detection"] = lambda: detect_stretch(recording, config.detector, 0, len(recording))
    for name in FRONT_ENDS:
        list(measure_motions(name, context, scans[:8]))  # loads what is compiled
    rounds = [[_spend(call) for call in parts.values()] for _ in range(_ROUNDS)]
    spent = dict(zip(parts, np.median(rounds, axis=0).tolist(), strict=True))
    turns = len(recording)
    return [
        Row(
            {
                "world": world,
                "part": part,
                "ms": 1e3 * seconds / turns,
                "of_rival": seconds / spent[_REGISTRATION],
                "real_time": turns * recording.revolution_s / seconds,
            },
            judged=part == OURS,
        )
        for part, seconds in spent.items()
    ]


def _spend(call: Callable[[], object]) -> float:
    begin = time.process_time()
    call()
    return time.process_time() - begin


BENCHMARK = Benchmark(
    what="Processor time of each part on one core, the median of three rounds.",
    data="simulated",
    seeds=(_SEED,),
    columns=(
        label("world", "world"),
        label("part", "part"),
        Column("ms", "[ms] per scan", "{:.1f}"),
        Column("of_rival", "of register_frame's time", "{:.2f}", Goal.FAST),
        Column("real_time", "times real time", "{:.0f}"),
    ),
    measure=_measure,
    bounds=(
        Bound("real_time", {"part": OURS}, least=8.0),
        Bound("of_rival", {"world": "hard", "part": OURS}, most=1.5),
    ),
)
