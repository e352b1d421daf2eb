"""A simulated street that was mapped on one day, and passes through it on another, with motions as odometry has them."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from mqslam.backend.loops.passes import MappedDrive
from mqslam.backend.loops.recognition import describe_places
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.keyframes import KeyframeMap, MappedRecording
from mqslam.core.measurement import Measurement
from mqslam.core.scans import Scans
from mqslam.detection.stage import detect_all
from mqslam.execution.local_engine import HERE
from mqslam.mapping.keyframing import make_keyframes
from mqslam.psi.place import beam_of
from mqslam.simulator import SensorModel, make_loop_drive, make_street_scene, simulate_recording

CONFIG = Config()
BEAM = beam_of(CONFIG.estimator, 0.0)
SENSOR = SensorModel(azimuths=200, range_resolution=0.175, max_range=80.0)
SIGMAS = np.array([0.02, 0.02, 0.001])
"""Standard deviation of a motion between two scans [m, m, rad]."""


class Pass(NamedTuple):
    """A pass through a street: its scans, the true poses (N, 3) in the world, and noisy motions between them."""

    scans: Scans
    truth: se2.Array
    motions: list[Measurement]


@lru_cache(maxsize=8)
def street_pass(seed: int, duration_s: float, town: int = 1, movers: int = 0) -> Pass:
    """Returns a drive along a street and round its corner; another seed is another day's noise."""
    recording = simulate_recording(
        make_street_scene(town, movers=movers), make_loop_drive(duration_s), duration_s=duration_s, sensor=SENSOR, seed=seed
    )
    scans, _ = detect_all(recording, CONFIG.detector)
    assert recording.ground_truth is not None
    truth, times = recording.ground_truth.poses, scans.start_times
    noise = SIGMAS * np.random.default_rng(seed).standard_normal((len(truth) - 1, 3))
    steps = se2.wrapped_between(truth[:-1], truth[1:]) + noise
    covariance = np.diag(SIGMAS**2)
    return Pass(scans, truth, [Measurement(times[k], times[k + 1], step, covariance) for k, step in enumerate(steps)])


@lru_cache(maxsize=4)
def street_map(duration_s: float) -> KeyframeMap:
    """Returns the map of a street as a run with true poses would keep it."""
    mapped = street_pass(1, duration_s)
    source = MappedRecording("mapped", 0, round(1e6 * duration_s), mapped.scans.revolution_s, 0.0)
    keyframes = make_keyframes(mapped.scans, mapped.truth, None, source, BEAM)
    drive = MappedDrive.of(keyframes)
    return KeyframeMap(keyframes, describe_places(drive, BEAM, HERE))
