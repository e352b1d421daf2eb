"""A whole map judged: a true one passes, a torn one fails and says where."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from support.drives import block_drive

from mqslam.auditing.judge import Audit, audit
from mqslam.auditing.revisits import find_revisit_pairs
from mqslam.auditing.sizes import STEP_FEWEST, WINDOW
from mqslam.auditing.sweeps import Sweeps, place_sweeps
from mqslam.auditing.verdict import VerdictStatus
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.core.trajectory import Trajectory
from mqslam.execution.local_engine import HERE, LocalEngine
from mqslam.execution.progress import ignore_progress
from mqslam.psi.place import beam_of

CONFIG = Config()
BEAM = beam_of(CONFIG.estimator, 0.0)


@lru_cache
def judged(shift_m: float, jobs: int = 1) -> Audit:
    """Returns the lap under a trajectory whose second pass is shifted sideways, slowly enough to bend no window."""
    recording, scans = block_drive()
    truth = recording.ground_truth
    along = np.linspace(0.0, 1.0, len(truth))
    poses = truth.poses.copy()
    poses[:, 1] += shift_m * np.clip(4.0 * along - 1.0, 0.0, 1.0)
    sweeps, _ = place_sweeps(scans, Trajectory(truth.stamps_us, poses), BEAM)
    return audit(sweeps, CONFIG, LocalEngine(jobs), ignore_progress)


def test_the_true_map_passes() -> None:
    judgement = judged(0.0)
    assert judgement.verdict.status == "pass", judgement.verdict.reasons
    assert len(judgement.windows) == -(-len(block_drive()[1]) // WINDOW)
    assert judgement.windows[-1].end == len(block_drive()[1])
    sure = [r for r in judgement.revisits if r.sure]
    assert len(sure) >= 3 and max(r.distance_m for r in sure) < 0.2
    assert not any(r.torn for r in judgement.revisits)


@pytest.mark.parametrize(("jump_m", "status"), [(0.0, "pass"), (2.0, "fail")])
def test_poses_of_every_fourth_scan_pass_and_still_show_a_jump(jump_m: float, status: str) -> None:
    recording, scans = block_drive()
    truth = recording.ground_truth
    poses = truth.poses.copy()
    poses[len(poses) // 2 :, 0] += jump_m
    sparse = Trajectory(truth.stamps_us[::4], poses[::4])
    sweeps, _ = place_sweeps(scans, sparse, BEAM)
    judgement = audit(sweeps, CONFIG, LocalEngine(2), ignore_progress)
    assert judgement.verdict.status == status, judgement.verdict.reasons
    assert any("too sparse for its turns" in finding.reason for finding in judgement.tests["trajectory"])
    if status == "pass":  # nothing is claimed of steps in turns, where a jump may be interpolation's
        shown = [step for step in judgement.steps if step.judged and step.registration.doubt_m <= CONFIG.audit.jump_m]
        assert len(shown) < STEP_FEWEST <= sum(step.judged for step in judgement.steps)
        assert not judgement.tests["steps"][0].judged


@pytest.mark.parametrize("is_shown", [True, False])
def test_a_jump_of_the_poses_fails_a_short_map_only_if_its_scans_show_it(is_shown: bool) -> None:
    """If they do not, the stamps of the poses may jitter. Too few steps show how far a step is off by chance."""
    recording, scans = block_drive()
    truth, few = recording.ground_truth, scans.take(range(28))
    jumped = truth.poses + np.where(np.arange(len(truth)) >= 14, 1.2, 0.0)[:, None] * [1.0, 0.0, 0.0]
    sweeps, _ = place_sweeps(few, Trajectory(truth.stamps_us, jumped if is_shown else truth.poses), BEAM)
    assert sweeps.track is not None
    sweeps = replace(sweeps, track=replace(sweeps.track, poses=jumped))
    judgement = audit(sweeps, CONFIG, HERE, ignore_progress)
    (finding,) = judgement.tests["trajectory"]
    assert finding.status == ("fail" if is_shown else "warn") and "no vehicle moves like that" in finding.reason
    assert not judgement.tests["steps"][0].judged


def test_a_torn_loop_fails_and_its_offset_is_measured() -> None:
    judgement = judged(3.0)
    assert judgement.verdict.status == "fail"
    assert any("revisits are torn" in reason for reason in judgement.verdict.reasons)
    torn = [r for r in judgement.revisits if r.torn]
    assert len(torn) >= 3
    recording, _ = block_drive()
    for r in torn:  # offsets are in the frame of the later sweep; the world's y is what was shifted
        yaw = recording.ground_truth.poses[r.registration.later][2]
        world = se2.transform(np.array([0.0, 0.0, yaw]), r.offset[None, :2])[0]
        assert world == pytest.approx([0.0, -3.0], abs=0.4)


@pytest.mark.parametrize("wrong", ["straight", "still", "spinning", "mirrored"])
def test_a_trajectory_that_has_nothing_to_do_with_the_recording_fails(wrong: str) -> None:
    recording, scans = block_drive()
    truth = recording.ground_truth
    times = (truth.stamps_us - truth.stamps_us[0])[:, None] * 1e-6
    poses = {
        "straight": times * [12.0, 0.0, 0.0],
        "still": times * [0.0, 0.0, 0.0],
        "spinning": times * [0.0, 0.0, 0.5],
        "mirrored": truth.poses * [1.0, -1.0, -1.0],
    }[wrong]
    sweeps, _ = place_sweeps(scans, Trajectory(truth.stamps_us, poses), BEAM)
    judgement = audit(sweeps, CONFIG, LocalEngine(2), ignore_progress)
    assert judgement.verdict.status == "fail", judgement.verdict.reasons


def test_the_verdict_does_not_depend_on_the_number_of_processes() -> None:
    one, three = judged(0.0), judged(0.0, 3)
    assert [w.bend.inflation for w in one.windows] == [w.bend.inflation for w in three.windows]
    assert [r.inflation for r in one.revisits] == [r.inflation for r in three.revisits]


def test_revisits_are_looked_for_where_the_path_comes_back_only() -> None:
    recording, scans = block_drive()
    sweeps, _ = place_sweeps(scans, recording.ground_truth, BEAM)
    settings = CONFIG.audit
    pairs = find_revisit_pairs(sweeps, settings)
    assert pairs
    for a, b in pairs:
        path = sweeps.travelled[b] - sweeps.travelled[a]
        assert path > settings.least_path_m
        assert np.hypot(*(sweeps.poses[a] - sweeps.poses[b])[:2]) <= settings.reach_m + settings.drift * path


def points_of(kind: str, rng: np.random.Generator) -> np.ndarray:
    """Returns the points (N, 2) [m] of one scan, of the kinds that leave directions untold."""
    return {
        "none": np.empty((0, 2)),
        "one": rng.uniform(-50.0, 50.0, (1, 2)),
        "two": rng.uniform(-50.0, 50.0, (2, 2)),
        "one object": np.tile([[10.0, 3.0]], (20, 1)),
        "at the sensor": np.full((10, 2), 1e-9),
        "one direction": np.column_stack([rng.uniform(3.0, 60.0, 40), np.zeros(40)]),
        "one wall": np.column_stack([rng.uniform(-50.0, 50.0, 40), np.full(40, 3.0)]),
        "noise": rng.uniform(-50.0, 50.0, (60, 2)),
    }[kind]


@pytest.mark.parametrize("speed", [0.0, 8.0])
@pytest.mark.parametrize("beside", [None, "noise"])
@pytest.mark.parametrize("kind", ["one", "two", "one object", "at the sensor", "one direction", "one wall"])
def test_a_window_that_tells_next_to_nothing_is_judged_all_the_same(kind: str, beside: str | None, speed: float) -> None:
    rng = np.random.default_rng(3)
    judgement = audit(sparse([kind, beside or kind] * 3, rng, speed), CONFIG, HERE, ignore_progress)
    (scan,) = judgement.windows
    assert np.isfinite([scan.bend.inflation, scan.bend.size_m, *np.diag(scan.bend.covariance)]).all()
    assert scan.bend.inflation >= 0.0
    assert judgement.verdict.status is VerdictStatus.NOT_JUDGED


def test_windows_without_a_point_are_left_out() -> None:
    rng = np.random.default_rng(3)
    judgement = audit(sparse(["noise"] * 6 + ["none"] * 13 + ["noise"] * 6, rng, 8.0), CONFIG, HERE, ignore_progress)
    assert [(w.begin, w.end) for w in judgement.windows] == [(0, 6), (18, 24), (19, 25)]


def sparse(kinds: list[str], rng: np.random.Generator, speed: float) -> Sweeps:
    """Returns sweeps of points of some kinds under a straight drive."""
    scans = []
    for k, kind in enumerate(kinds):
        points = points_of(kind, rng)
        times = np.sort(rng.uniform(0.25 * k, 0.25 * (k + 1), len(points)))
        ranges, azimuths = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])
        scans.append(Scan(0.25 * k, 0.25 * (k + 1), Returns(ranges, azimuths, times, np.full(len(points), 80.0))))
    numbers = np.arange(len(kinds))
    track = Trajectory(250_000 * numbers, np.column_stack([0.25 * speed * numbers, 0.0 * numbers, 0.0 * numbers]))
    return place_sweeps(Scans(tuple(scans), 0, 0.25), track, BEAM)[0]
