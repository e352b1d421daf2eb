"""Solves a recording in this process, for benchmarks that look at what a run does not write."""

from __future__ import annotations

from dataclasses import replace

from mqslam.backend.measuring import find_doppler
from mqslam.config import Config
from mqslam.core.frontend import Context
from mqslam.core.recording import Recording
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
        scans, _ = detect_all(recording, config.detector, runner)
        beta, sigma = find_doppler(scans, config, runner)
        context = Context.of(recording, config, odometry, sensors)
        found = replace(context, doppler_beta=beta, doppler_sigma=sigma, engine=engine)
        return Slam(config, runner=runner).solve(scans, found)
