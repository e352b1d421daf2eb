"""Solves a recording in this process, for benchmarks that look at what a run does not write."""

from __future__ import annotations

from dataclasses import replace

from mqslam.backend.measuring import find_doppler
from mqslam.config import Config
from mqslam.core.frontend import Context
from mqslam.core.recording import Recording
from mqslam.core.scans import Scans
from mqslam.core.sensors import NO_SENSORS, Sensors
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.runner import Runner
from mqslam.slam import Slam
from mqslam.solution import Solution


def solve(
    recording: Recording, config: Config, odometry: Trajectory | None = None, sensors: Sensors = NO_SENSORS
) -> Solution:
    """Detects the returns of a recording and solves for its trajectory by psi, with the given odometry and sensors."""
    with LocalEngine(2) as engine:
        runner = Runner(engine)
        scans, context = prepare(recording, config, runner, odometry, sensors)
        return Slam(config, runner=runner).solve(scans, replace(context, engine=engine))


def prepare(
    recording: Recording,
    config: Config,
    runner: Runner,
    odometry: Trajectory | None = None,
    sensors: Sensors = NO_SENSORS,
) -> tuple[Scans, Context]:
    """Detects the returns of a recording; returns its scans and what front ends may know, with the Doppler shift by psi."""
    scans, _ = detect_all(recording, config.detector, runner)
    beta, sigma = find_doppler(scans, config, runner)
    return scans, replace(Context.of(recording, config, odometry, sensors), doppler_beta=beta, doppler_sigma=sigma)
