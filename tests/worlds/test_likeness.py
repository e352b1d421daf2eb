"""The hard city is like real radar in everything that `worlds.statistics` measures, within stated bounds.

The figures of the real sample are those that `tests/worlds/test_statistics.py` holds the sample itself to. The sample was
driven at 6 to 10 m/s, and so are the stretches of these drives: at rest everything is seen again.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from worlds.hard import make_hard_world
from worlds.statistics import Statistics, measure_statistics

from mqslam.config import Config
from mqslam.simulator import (
    Drive,
    Scene,
    SensorModel,
    make_city_drive,
    make_city_scene,
    make_loop_drive,
    make_street_scene,
    simulate_recording,
)

COARSE = SensorModel(range_resolution=0.175, max_range=120.0)
DURATION_S = 100.0
BOUNDS: list[tuple[str, list[float], list[float]]] = [
    ("returns_per_azimuth", [2.5], [0.5]),
    ("power", [6.0, 30.0, 77.0, 107.0], [0.9, 4.5, 11.55, 16.05]),
    ("azimuth_correlation", [0.74, 0.62, 0.45], [0.1] * 3),
    ("range_correlation", [0.87, 0.67, 0.56, 0.49], [0.1] * 4),
    ("repeats", [0.42, 0.30], [0.05] * 2),
    ("matched", [0.53], [0.06]),
    ("psi_per_point", [1.28], [0.13]),
    ("unmatched", [0.36], [0.05]),
    ("row_median", [8.8], [3.0]),
]


def measure(scene: Scene, drive: Drive, seed: int) -> Statistics:
    """Returns the statistics of a drive through a hard world."""
    recording = simulate_recording(scene, drive, duration_s=DURATION_S, sensor=COARSE, seed=seed, world=make_hard_world)
    return measure_statistics(recording, Config())


def excess(figures: Statistics, name: str, real: list[float], bounds: list[float]) -> NDArray[np.float64]:
    """Returns by how many bounds figures differ from the real ones."""
    value: Any = getattr(figures, name)
    return np.abs(np.atleast_1d(value) - real) / bounds


def test_a_few_scans_of_a_hard_street_are_roughly_like_real_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mqslam.check.stretches.STRETCHES", 1)
    monkeypatch.setattr("mqslam.check.stretches.STRETCH_SCANS", 7)
    figures = measure(make_street_scene(1, movers=0), make_loop_drive(DURATION_S), 1)
    assert figures.scans == 7
    for name, real, bounds in BOUNDS:
        assert np.all(excess(figures, name, real, bounds) < 2.5), name


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_hard_city_has_the_statistics_of_real_radar(seed: int) -> None:
    figures = measure(make_city_scene(seed), make_city_drive(seed, DURATION_S), seed)
    for name, real, bounds in BOUNDS:
        assert np.all(excess(figures, name, real, bounds) < 1.0), name
