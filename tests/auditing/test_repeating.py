"""Streets that repeat: a map of one is never told to be torn by a period, because another place fits as well."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from support.passes import BEAM, CONFIG, joined

from mqslam.auditing.findings import judge_revisits
from mqslam.auditing.revisits import RevisitAudit, audit_revisits
from mqslam.auditing.sweeps import place_sweeps
from mqslam.auditing.verdict import VerdictStatus
from mqslam.backend.loops.passes import TrackedRun
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all
from mqslam.execution.local_engine import HERE
from mqslam.execution.progress import ignore_progress
from mqslam.simulator import ConstantDrive, Scene, SensorModel, simulate_recording

PERIOD_M = 5.0
SENSOR = SensorModel(azimuths=200, range_resolution=0.175, max_range=40.0)


def fenced_street(*, repeats: bool) -> Scene:
    """Returns a street along x with posts on both sides, of which every period has the same, unless they do not repeat."""
    rng = np.random.default_rng(7)
    periods, posts = np.arange(-14, 26) * PERIOD_M, 8
    places = []
    cell = np.column_stack([rng.uniform(0.0, PERIOD_M, posts), rng.choice([-1, 1], posts) * rng.uniform(5.0, 12.0, posts)])
    for begin in periods:
        if not repeats:
            cell = np.column_stack([rng.uniform(0.0, PERIOD_M, posts), rng.permutation(cell[:, 1])])
        places.append(cell + np.array([begin, 0.0]))
    xy = np.concatenate(places)
    return Scene(poles=np.column_stack([xy, np.full(len(xy), 0.15), np.full(len(xy), 1.5)]))


@lru_cache(maxsize=4)
def one_pass(seed: int, *, repeats: bool) -> TrackedRun:
    """Returns 64 m along the street under their true poses."""
    motion = ConstantDrive(8.0, 0.0, (0.0, 0.0, 0.0))
    recording = simulate_recording(fenced_street(repeats=repeats), motion, duration_s=8.0, sensor=SENSOR, seed=seed)
    scans, _ = detect_all(recording, CONFIG.detector)
    return TrackedRun.of(scans, recording.ground_truth.poses[: len(scans)])


def judged(shift_m: float, *, repeats: bool) -> list[RevisitAudit]:
    """Returns the revisits of two passes, of which the trajectory has the second one shifted along the street."""
    first, second = one_pass(1, repeats=repeats), one_pass(2, repeats=repeats)
    drive = joined(first, second, second.poses + np.array([shift_m, 0.0, 0.0]))
    track = Trajectory(np.round(1e6 * drive.times).astype(np.int64), drive.poses)
    sweeps, _ = place_sweeps(Scans(tuple(drive.scans), 0, 0.25), track, BEAM)
    return audit_revisits((sweeps, CONFIG.audit, CONFIG.estimator), CONFIG.verdict, HERE, ignore_progress)


@pytest.mark.parametrize("shift_m", [0.0, 1.5, -2.4])
def test_a_period_is_a_rival_and_no_tear(shift_m: float) -> None:
    revisits = judged(shift_m, repeats=True)
    assert len(revisits) >= 4
    assert not any(r.torn for r in revisits)
    assert not any(r.sure and r.distance_m > 0.5 for r in revisits)
    assert judge_revisits(revisits, CONFIG.audit, CONFIG.verdict).status is VerdictStatus.PASS


def test_the_same_shift_is_a_tear_where_nothing_repeats() -> None:
    assert not any(r.torn for r in judged(0.0, repeats=False))
    assert all(r.torn for r in judged(-2.4, repeats=False) if r.sure)
    assert sum(r.torn for r in judged(-2.4, repeats=False)) >= 4
