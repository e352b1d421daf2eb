"""Passes over simulated places, with true poses, and paths without any radar."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from mqslam.backend.loops import passes
from mqslam.backend.loops.passes import TrackedRun
from mqslam.backend.problem import Problem
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.measurement import Loop, Measurement
from mqslam.core.scans import Returns, Scan
from mqslam.detection.stage import detect_all
from mqslam.psi.place import beam_of
from mqslam.simulator import ConstantDrive, Scene, SensorModel, make_corridor_scene, make_street_scene, simulate_recording

CONFIG = Config()
BEAM = beam_of(CONFIG.estimator, 0.0)
SENSOR = SensorModel(range_resolution=0.175, max_range=80.0)
LANE_Y, OTHER_LANE_Y = -37.75, -34.25  # the two lanes of the street south of the middle block
MIDDLE = 10  # a scan in the middle of a pass


def let_passes_follow(apart_m: float) -> Any:
    """Returns a fixture that lets passes follow each other so soon that those of the tests count: after `apart_m` [m]."""

    @pytest.fixture(scope="module", autouse=True)
    def near_passes() -> Iterator[None]:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(passes, "LEAST_PATH_M", apart_m)
            yield

    return near_passes


@lru_cache(maxsize=16)
def street_pass(x: float, y: float, yaw: float, seed: int) -> TrackedRun:
    """Returns five seconds at 8 m/s along a street without traffic; another seed is another day's noise."""
    return _driven(make_street_scene(1, movers=0), (x, y, yaw), seed)


@lru_cache(maxsize=16)
def corridor_pass(x: float, y: float, seed: int) -> TrackedRun:
    """Returns a drive like that of `street_pass` along two bare walls."""
    return _driven(make_corridor_scene(), (x, y, 0.0), seed)


def _driven(scene: Scene, start: tuple[float, float, float], seed: int) -> TrackedRun:
    recording = simulate_recording(scene, ConstantDrive(8.0, 0.0, start), duration_s=5.0, sensor=SENSOR, seed=seed)
    scans, _ = detect_all(recording, CONFIG.detector)
    assert recording.ground_truth is not None
    return TrackedRun.of(scans, recording.ground_truth.poses)


def joined(first: TrackedRun, second: TrackedRun, poses: se2.Array | None = None) -> TrackedRun:
    """Returns two passes as one drive, a minute apart; poses (N, 3), if given, take the place of the second pass's own."""
    late = float(first.times[-1]) + 60.0
    scans = list(first.scans)
    for w in second.scans:
        r = w.returns
        scans.append(Scan(w.t0 + late, w.t1 + late, Returns(r.ranges, r.azimuths, r.times + late, r.intensities)))
    return TrackedRun.of(scans, np.concatenate([first.poses, second.poses if poses is None else poses]))


@lru_cache(maxsize=1)
def noisy_passes() -> tuple[TrackedRun, Problem, Loop]:
    """Returns two true passes over a street, a problem of noisy motions along them, and a loop that is somewhat off."""
    earlier, later = street_pass(-25.0, LANE_Y, 0.0, 1), street_pass(-22.0, LANE_Y, 0.0, 2)
    drive = joined(earlier, later)
    rng = np.random.default_rng(1)
    sigmas = np.array([0.02, 0.02, 0.001])
    motions = []
    for k, motion in enumerate(se2.wrapped_between(drive.poses[:-1], drive.poses[1:])):
        wide = 50.0 if k + 1 == len(earlier.times) else 1.0  # nobody saw the way between them
        noisy = motion + wide * sigmas * rng.standard_normal(3)
        motions.append(Measurement(drive.times[k], drive.times[k + 1], noisy, np.diag((wide * sigmas) ** 2)))
    first, second = 10, 10 + len(earlier.times)
    pose = se2.between(drive.poses[first], drive.poses[second]) + np.array([0.08, -0.06, 0.003])
    loop = Loop(first, second, pose, np.diag([1e-3, 1e-3, 1e-6]), 0.7, 0.5)
    return drive, Problem(motions, []), loop


def path(xy: np.ndarray) -> TrackedRun:
    """Returns a drive without returns along places (N, 2) [m], a scan at each."""
    nothing = Returns(*(np.empty(0) for _ in range(4)))
    scans = [Scan(0.25 * k, 0.25 * (k + 1), nothing) for k in range(len(xy))]
    ahead = np.diff(xy, axis=0, append=2.0 * xy[-1:] - xy[-2:-1])
    return TrackedRun.of(scans, np.column_stack([xy, np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))]))
