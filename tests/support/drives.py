"""Simulated drives, rendered in memory and detected, small enough for tests."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all
from mqslam.simulator import ConstantDrive, Drive, Scene, SensorModel, SimulatedRecording, simulate_recording

SENSOR = SensorModel(range_resolution=0.0875, max_range=60.0)
QUIET_SENSOR = SensorModel(
    range_resolution=0.175,
    max_range=60.0,
    noise_level=0.0,
    speckle=0.0,
    roughness=0.0,
    saturation_probability=0.0,
    clutter_probability=0.0,
)
ON_THE_STREET = (-20.0, -37.75, 0.0)  # on the right-hand lane of a street scene, heading along x


def detected(recording: SimulatedRecording) -> Scans:
    """Returns the scans of a recording under the default settings."""
    scans, _ = detect_all(recording, Config().detector)
    return scans


def drive(
    scene: Scene, motion: Drive, duration_s: float, seed: int = 1, doppler_beta: float = 0.0, max_range: float = 60.0
) -> tuple[SimulatedRecording, Scans]:
    """Returns a drive and its scans."""
    sensor = SensorModel(range_resolution=0.0875, max_range=max_range, doppler_beta=doppler_beta)
    recording = simulate_recording(scene, motion, duration_s=duration_s, sensor=sensor, seed=seed)
    return recording, detected(recording)


@lru_cache(maxsize=1)
def street_drive() -> tuple[SimulatedRecording, Scans]:
    """Returns a drive of ten seconds along a street and into its corner, past moving vehicles."""
    from mqslam.simulator import clear_way, make_loop_drive, make_street_scene

    motion = make_loop_drive(10.0, speed=8.0)
    return drive(clear_way(make_street_scene(1, movers=4), motion, 10.0), motion, 10.0)


def street_context(config: Config | None = None, odometry: Trajectory | None = None, doppler_beta: float = 0.0) -> Context:
    """Returns what a front end knows of `street_drive` besides its scans, by default with the default settings."""
    recording, _ = street_drive()
    return Context(config or Config(), recording.revolution_s, recording.start_us, odometry, doppler_beta)


def drive_around_a_block(duration_s: float = 54.0, seed: int = 1) -> SimulatedRecording:
    """Returns a bit more than one round of a block: the last 100 m of 54 s, or 150 m of 60 s, are driven twice."""
    from mqslam.simulator import make_loop_drive, make_street_scene

    sensor = SensorModel(azimuths=200, range_resolution=0.175, max_range=80.0)
    scene, motion = make_street_scene(seed, movers=0), make_loop_drive(duration_s)
    return simulate_recording(scene, motion, duration_s=duration_s, sensor=sensor, seed=seed)


@lru_cache(maxsize=1)
def block_drive() -> tuple[SimulatedRecording, Scans]:
    """Returns a bit more than one round of a block, and its scans."""
    recording = drive_around_a_block()
    return recording, detected(recording)


def constant(v: float, omega: float) -> ConstantDrive:
    """Returns a constant motion that starts on the street."""
    return ConstantDrive(v, omega, ON_THE_STREET)


def joined(scans: Sequence[Scan]) -> Returns:
    """Returns the returns of several scans as one."""
    return Returns.concatenate([w.returns for w in scans])


def find_errors(recording: SimulatedRecording, motions: Sequence[Measurement]) -> se2.Array:
    """Returns by how much (N, 3) motions are off the simulated ones [m, m, rad]."""
    truth = [se2.between(*recording.drive.poses(np.array([m.t0, m.t1]))) for m in motions]
    errors = se2.between(truth, np.array([m.pose for m in motions]))
    errors[:, 2] = se2.wrap(errors[:, 2])
    return errors


def noise(scan: Scan, count: int = 400, seed: int = 1) -> Scan:
    """Returns a scan of returns that are nowhere in the world."""
    rng = np.random.default_rng(seed)
    times = np.sort(rng.uniform(scan.t0, scan.t1, count))
    azimuths = -2.0 * np.pi * (times - scan.t0) / (scan.t1 - scan.t0)
    return Scan(scan.t0, scan.t1, Returns(rng.uniform(3.0, 60.0, count), azimuths, times, np.full(count, 80.0)))
