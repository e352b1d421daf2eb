"""A whole map judged: a true one passes, a torn one fails and says where."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from mqslam.audit.judge import Audit, audit, verdict
from mqslam.audit.revisits import revisit_pairs
from mqslam.audit.sweeps import swept
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all
from mqslam.execution.engine import HERE, LocalEngine
from mqslam.psi.place import beam_of
from mqslam.simulator import SensorModel, SimulatedRecording, loop_drive, simulated_recording, street_scene

CONFIG = Config()
SETTINGS = (CONFIG.audit, CONFIG.estimator, CONFIG.loops)
BEAM = beam_of(CONFIG.estimator, 0.0)
SENSOR = SensorModel(azimuths=200, range_resolution=0.175, max_range=80.0)


def silent(stage: str, done: int, total: int) -> None:
    pass


@lru_cache
def lap() -> tuple[SimulatedRecording, Scans]:
    """A bit more than one round of a block: the last 100 m are driven twice."""
    recording = simulated_recording(street_scene(1, movers=0), loop_drive(54.0), duration_s=54.0, sensor=SENSOR, seed=1)
    return recording, detect_all(recording, CONFIG.detector, HERE, silent)[0]


@lru_cache
def judged(shift_m: float, jobs: int = 1) -> Audit:
    """The lap under a trajectory whose second pass is shifted sideways, slowly enough to bend no window."""
    recording, scans = lap()
    truth = recording.ground_truth
    along = np.linspace(0.0, 1.0, len(truth))
    poses = truth.poses.copy()
    poses[:, 1] += shift_m * np.clip(4.0 * along - 1.0, 0.0, 1.0)
    sweeps, _ = swept(scans, Trajectory(truth.stamps_us, poses), BEAM)
    return audit(sweeps, *SETTINGS, LocalEngine(jobs), silent)


def test_the_true_map_passes() -> None:
    found = judged(0.0)
    assert found.status == "pass", found.reasons
    assert len(found.windows) == -(-len(lap()[1]) // CONFIG.audit.window)
    assert found.windows[-1].end == len(lap()[1])
    sure = [r.revisit for r in found.revisits if r.revisit.sure]
    assert len(sure) >= 3 and max(r.distance_m for r in sure) < 0.2
    assert not any(r.torn for r in found.revisits)


def test_a_torn_loop_fails_and_its_offset_is_measured() -> None:
    found = judged(3.0)
    assert found.status == "fail"
    assert any("revisits are torn" in reason for reason in found.reasons)
    torn = [r.revisit for r in found.revisits if r.torn]
    assert len(torn) >= 3
    recording, _ = lap()
    for r in torn:  # offsets are in the frame of the later sweep; the world's y is what was shifted
        yaw = recording.ground_truth.poses[r.later][2]
        world = se2.transform(np.array([0.0, 0.0, yaw]), r.offset[None, :2])[0]
        assert world == pytest.approx([0.0, -3.0], abs=0.4)


@pytest.mark.parametrize("wrong", ["straight", "still", "spinning", "mirrored"])
def test_a_trajectory_that_has_nothing_to_do_with_the_recording_fails(wrong: str) -> None:
    recording, scans = lap()
    truth = recording.ground_truth
    times = (truth.stamps_us - truth.stamps_us[0])[:, None] * 1e-6
    poses = {
        "straight": times * [12.0, 0.0, 0.0],
        "still": times * [0.0, 0.0, 0.0],
        "spinning": times * [0.0, 0.0, 0.5],
        "mirrored": truth.poses * [1.0, -1.0, -1.0],
    }[wrong]
    sweeps, _ = swept(scans, Trajectory(truth.stamps_us, poses), BEAM)
    found = audit(sweeps, *SETTINGS, LocalEngine(2), silent)
    assert found.status == "fail", found.reasons


def test_the_verdict_does_not_depend_on_the_number_of_threads() -> None:
    one, three = judged(0.0), judged(0.0, 3)
    assert [w.bend.inflation for w in one.windows] == [w.bend.inflation for w in three.windows]
    assert [r.revisit.inflation for r in one.revisits] == [r.revisit.inflation for r in three.revisits]


def test_revisits_are_looked_for_where_the_path_comes_back_only() -> None:
    recording, scans = lap()
    sweeps, _ = swept(scans, recording.ground_truth, BEAM)
    settings = CONFIG.audit
    pairs = revisit_pairs(sweeps, settings)
    assert pairs
    for a, b in pairs:
        path = sweeps.travelled[b] - sweeps.travelled[a]
        assert path > settings.least_path_m
        assert np.hypot(*(sweeps.poses[a] - sweeps.poses[b])[:2]) <= settings.reach_m + settings.drift * path


def test_a_verdict_of_nothing_says_that_nothing_came_back() -> None:
    status, reasons = verdict([], [])
    assert status == "pass" and any("comes back to no place" in reason for reason in reasons)
