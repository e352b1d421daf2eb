"""One evaluation of the published psi with its gradient, against a reference by SciPy's tree and NumPy."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import numpy as np
from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label
from bench.measuring.recordings import simulate_short_city

from mqslam.config import Config, DetectorConfig, PsiConfig
from mqslam.core.motion import CONSTANT_VELOCITY
from mqslam.core.scans import Returns
from mqslam.detection import detector
from mqslam.detection.stage import detect_stretch
from mqslam.formats.recordings import open_recording
from mqslam.psi.minimiser import kernel_of
from mqslam.psi.neighbours import find_candidates, sort_into_cells
from mqslam.psi.place import PointSet, beam_of
from mqslam.psi.published.equations import score
from mqslam.psi.published.reference import score_reference
from mqslam.psi.window import Window

_SEED = 11  # of a drive that `heading` measures too
_FIRST, _SCANS = 100, 3
_MOTION = np.array([8.0, 0.03])  # near the motions that a search tries [m/s, rad/s]
_ROUNDS, _REPEATS = 7, 25
_JOINS_M = {"default": detector._JOIN_M, "without non-maximum suppression": 0.0}  # one target within so much range


def _measure(out: Path) -> list[Row]:
    return [_measure_detector(name, join_m) for name, join_m in _JOINS_M.items()]


def _measure_detector(name: str, join_m: float) -> Row:
    points, turn_s = _make_window(join_m)
    config = PsiConfig()
    lists = find_candidates(sort_into_cells(points.points, config.s), points.points, config.s)
    calls: list[Callable[[], object]] = [
        lambda: score(points.points, points.times, turn_s, config, points.jacobians, lists),
        lambda: score(points.points, points.times, turn_s, config, points.jacobians, None),
        lambda: score_reference(points.points, points.times, turn_s, config, points.jacobians),
    ]
    calls[0]()
    repeats = (_REPEATS, _REPEATS, 1)
    rounds = [[_spend(call, number) for call, number in zip(calls, repeats, strict=True)] for _ in range(_ROUNDS)]
    ours, anew, reference = np.median(rounds, axis=0).tolist()
    return Row(
        {
            "detector": name,
            "points": float(len(points)),
            "reference": 1e3 * reference,
            "ours": 1e3 * ours,
            "anew": 1e3 * anew,
            "share": ours / reference,
        }
    )


def _make_window(join_m: float) -> tuple[PointSet, float]:
    """Returns the points of a window under a motion, and the time of a turn [s]."""
    recording = open_recording(simulate_short_city("hard", _SEED))
    with patch.object(detector, "_JOIN_M", join_m):
        returns = Returns.concatenate(detect_stretch(recording, DetectorConfig(), _FIRST, _FIRST + _SCANS).returns)
    estimator, t0, turn_s = Config().estimator, float(recording.start_times[_FIRST]), recording.revolution_s
    window = Window(returns, t0, kernel_of(estimator, turn_s), estimator, beam_of(estimator, 0.0))
    return window.render(_MOTION, CONSTANT_VELOCITY), turn_s


def _spend(call: Callable[[], object], number: int) -> float:
    """Returns the median time [s] of a number of calls."""
    spent = []
    for _ in range(number):
        begin = time.perf_counter()
        call()
        spent.append(time.perf_counter() - begin)
    return float(np.median(spent))


BENCHMARK = Benchmark(
    what="One evaluation of the published psi with its gradient by v and omega, on three scans.",
    data="simulated",
    seeds=(_SEED,),
    columns=(
        label("detector", "detector"),
        Column("points", "points", "{:.0f}"),
        Column("reference", "SciPy [ms]", "{:.0f}"),
        Column("ours", "ours [ms]", "{:.2f}"),
        Column("anew", "ours, lists built anew [ms]", "{:.2f}"),
        Column("share", "ours over SciPy", "{:.4f}", Goal.FAST),
    ),
    measure=_measure,
    bounds=(Bound("share", {}, most=0.01),),
)
