"""Two days in the same streets as one map, however the first one lies, and streets that repeat, which must not be merged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from bench.benchmark import Benchmark, Bound, Row
from bench.measuring.commands import run
from bench.measuring.merging import COLUMNS, Pair, measure_merge, move_result
from bench.measuring.recordings import TRUTH, draw_worlds, twin

from mqslam.formats.maps.keyframe_folder import read_keyframes
from mqslam.formats.tum import read_tum

_SEEDS = (1, 2)
_POSES = 10  # random starts of the first run
_FARTHEST_M = 1000.0
_LATEST = 0.5  # share of the keyframes that a start may leave out


def _measure(out: Path) -> list[Row]:
    data = [twin(name, "hard", seed) for name, seed in zip(("kaist01", "kaist02"), _SEEDS, strict=True)]
    first, second = (run(one, out / one.name) for one in data)
    truths = read_tum(data[0] / TRUTH), read_tum(data[1] / TRUTH)
    rng, count, rows = np.random.default_rng(0), len(read_keyframes(first).keyframes), []
    for n in range(1, _POSES + 1):
        frame = np.array([*rng.uniform(-_FARTHEST_M, _FARTHEST_M, 2), rng.uniform(-np.pi, np.pi)])
        moved = move_result(first, out / f"moved-{n}", frame, int(rng.uniform(0.0, _LATEST) * count))
        rows.append(measure_merge(f"kaist01 from start {n}, kaist02", Pair((moved, second), truths), out / f"merged-{n}"))
    for block in ("block8", "block12"):
        worlds = [twin(block, "kind", seed, data=draw_worlds(), movers=0) for seed in (2, 3)]
        results = [run(world, out / world.name) for world in worlds]
        pair = Pair((results[0], results[1]), (read_tum(worlds[0] / TRUTH), read_tum(worlds[1] / TRUTH)))
        rows.append(measure_merge(f"{block}, two seeds", pair, out / f"merged-{block}"))
    return rows


BENCHMARK = Benchmark(
    what="Two runs of the city twin, a day apart, radar alone, as one map: the first one's frame and start are drawn at "
    "random. In the blocks the streets repeat, so that several places fit.",
    data="twin",
    seeds=_SEEDS,
    columns=COLUMNS,
    measure=_measure,
    bounds=(Bound("rms_m", {"outcome": "merged"}, most=0.3), Bound("wrong", {}, most=0.0)),
)
