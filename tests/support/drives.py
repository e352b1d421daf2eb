"""Simulated drives, rendered in memory and detected, small enough for tests."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from mqslam.config import Config
from mqslam.core.scans import Returns, Window
from mqslam.detection.stage import detect_all
from mqslam.execution.engine import HERE
from mqslam.simulator import ConstantDrive, Drive, Scene, SensorModel, SimulatedStream, simulated_stream

SENSOR = SensorModel(range_resolution=0.0875, max_range=60.0)
ON_THE_STREET = (-20.0, -37.75, 0.0)  # on the right-hand lane of a street scene, heading along x


def detected(stream: SimulatedStream) -> list[Window]:
    """The windows of a stream under the default settings."""
    windows, _ = detect_all(stream, Config().detector, HERE, lambda stage, done, total: None)
    return windows


def drive(
    scene: Scene, motion: Drive, duration_s: float, seed: int = 1, doppler_beta: float = 0.0, max_range: float = 60.0
) -> tuple[SimulatedStream, list[Window]]:
    """A drive and its windows."""
    sensor = SensorModel(range_resolution=0.0875, max_range=max_range, doppler_beta=doppler_beta)
    stream = simulated_stream(scene, motion, duration_s=duration_s, sensor=sensor, seed=seed)
    return stream, detected(stream)


@lru_cache(maxsize=1)
def street_drive() -> tuple[SimulatedStream, list[Window]]:
    """Ten seconds along a street and into its corner, past moving vehicles."""
    from mqslam.simulator import loop_drive, street_scene, with_way_made

    motion = loop_drive(10.0, speed=8.0)
    return drive(with_way_made(street_scene(1, movers=4), motion, 10.0), motion, 10.0)


def constant(v: float, omega: float) -> ConstantDrive:
    """A constant motion that starts on the street."""
    return ConstantDrive(v, omega, ON_THE_STREET)


def joined(windows: list[Window]) -> Returns:
    """The returns of several windows as one."""
    return Returns.concatenate([w.returns for w in windows])


def noise(window: Window, count: int = 400, seed: int = 1) -> Window:
    """A window of returns that are nowhere in the world."""
    rng = np.random.default_rng(seed)
    times = np.sort(rng.uniform(window.t0, window.t1, count))
    azimuths = -2.0 * np.pi * (times - window.t0) / (window.t1 - window.t0)
    return Window(window.t0, window.t1, Returns(rng.uniform(3.0, 60.0, count), azimuths, times, np.full(count, 80.0)))
