"""Shaking: a map of poses that jump to and fro is crisper once they are smoothed, and that of right ones is not."""

from __future__ import annotations

import re
from functools import lru_cache

import numpy as np
import pytest
from support.drives import drive

from mqslam.auditing.sweeps import Sweeps, place_sweeps
from mqslam.auditing.verdict import Finding, VerdictStatus
from mqslam.auditing.windows.shaking import judge_shaking, smooth_poses
from mqslam.auditing.windows.windows import audit_windows
from mqslam.config import Config
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.execution.local_engine import HERE
from mqslam.execution.progress import ignore_progress
from mqslam.psi.place import beam_of
from mqslam.simulator import clear_way, make_loop_drive, make_street_scene

CONFIG = Config()
SECONDS = 30.0


@lru_cache(maxsize=1)
def street() -> tuple[Scans, Trajectory]:
    """Returns the scans of a drive and the true poses at their starts."""
    motion = make_loop_drive(SECONDS, speed=8.0)
    recording, scans = drive(clear_way(make_street_scene(1, movers=4), motion, SECONDS), motion, SECONDS)
    ends = np.r_[scans.start_times, scans[-1].t1]
    return scans, Trajectory(recording.start_us + np.round(1e6 * ends).astype(np.int64), recording.drive.poses(ends))


def registered(shift_m: float, scans: int | None = None) -> Sweeps:
    """Returns the map of the drive with every second pose shifted to the side."""
    recorded, truth = street()
    poses = truth.poses.copy()
    poses[::2, :2] += shift_m * np.column_stack([-np.sin(poses[::2, 2]), np.cos(poses[::2, 2])])
    return place_sweeps(recorded[:scans], Trajectory(truth.stamps_us, poses), beam_of(CONFIG.estimator, 0.0))[0]


def judged(sweeps: Sweeps) -> Finding:
    windows = audit_windows((sweeps, CONFIG.audit, CONFIG.estimator), HERE, ignore_progress)
    return judge_shaking((sweeps, CONFIG.audit, CONFIG.estimator), windows, CONFIG.verdict, HERE)


def test_a_right_trajectory_does_not_shake() -> None:
    finding = judged(registered(0.0))
    assert finding.judged and finding.status is VerdictStatus.PASS
    assert finding.p_value is not None and finding.p_value > 0.1


@pytest.mark.parametrize("shift_m", [0.2, 0.4])
def test_poses_that_jump_to_and_fro_are_a_warning_that_says_how_far(shift_m: float) -> None:
    finding = judged(registered(shift_m))
    assert finding.status is VerdictStatus.WARN
    said = re.search(r"is crisper once the poses are smoothed: the poses jump to and fro by (\d\.\d\d) m", finding.reason)
    assert said is not None and float(said[1]) == pytest.approx(0.5 * shift_m, rel=0.3)


def test_a_few_windows_judge_nothing() -> None:
    finding = judged(registered(0.4, scans=40))
    assert not finding.judged and finding.status is VerdictStatus.PASS


def test_poses_are_smoothed_where_as_many_lie_on_either_side() -> None:
    sweeps = registered(0.0)
    sweeps.numbers[30:] += 5.0
    known = np.isfinite(smooth_poses(sweeps)).all(axis=1)
    assert np.flatnonzero(~known).tolist() == [0, 1, 2, 27, 28, 29, 30, 31, 32, *range(len(sweeps) - 3, len(sweeps))]
    np.testing.assert_allclose(smooth_poses(sweeps)[known, :2], sweeps.poses[known, :2], atol=0.05)
