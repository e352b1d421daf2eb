"""A trajectory in another frame than its cloud, one that is mirrored, and one without headings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support.drives import block_drive

from mqslam.auditing.frame import judge_frame, judge_readings
from mqslam.auditing.sweeps import Sweeps, place_sweeps
from mqslam.auditing.verdict import Cause, VerdictStatus
from mqslam.auditing.windows.windows import audit_windows
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.progress import ignore_progress
from mqslam.psi.place import beam_of

CONFIG = Config()
BEAM = beam_of(CONFIG.estimator, 0.0)


def place(change: Callable[[se2.Array], se2.Array] = np.asarray) -> Sweeps:
    recording, scans = block_drive()
    truth = recording.ground_truth
    return place_sweeps(scans, Trajectory(truth.stamps_us, change(truth.poses)), BEAM)[0]


@pytest.mark.parametrize("moved", [(38.0, 0.0, 0.0), (0.0, -38.0, 0.0), (20.0, 30.0, 0.5), (0.0, 0.0, np.pi)])
def test_a_cloud_in_another_frame_than_its_trajectory_is_found(moved: tuple[float, float, float]) -> None:
    sweeps = place()
    assert judge_frame(sweeps).status is VerdictStatus.PASS
    elsewhere = replace(sweeps, points=se2.transform(np.array(moved), sweeps.points))
    finding = judge_frame(elsewhere)
    assert finding.status is VerdictStatus.FAIL and finding.cause is Cause.FRAME
    expected = np.sqrt(np.mean(np.sum((elsewhere.points - sweeps.points) ** 2, axis=1)))
    found = float(finding.reason.split(" m ")[0].split()[-1])
    assert found == pytest.approx(expected, rel=0.35, abs=6.0)


def test_few_scans_do_not_show_the_frame() -> None:
    sweeps = place()
    begins = np.r_[sweeps.begins[:20], np.full(len(sweeps.begins) - 20, sweeps.begins[20])]
    assert not judge_frame(replace(sweeps, begins=begins)).judged


def judge(change: Callable[[se2.Array], se2.Array]) -> tuple[VerdictStatus, str]:
    """Returns what is said of the block drive under a changed trajectory."""
    sweeps, engine = place(change), LocalEngine(1)
    windows = audit_windows((sweeps, CONFIG.audit, CONFIG.estimator), engine, ignore_progress)
    sections = CONFIG.audit, CONFIG.estimator

    def place_poses(poses: se2.Array) -> Sweeps:
        recording, scans = block_drive()
        return place_sweeps(scans, Trajectory(recording.ground_truth.stamps_us, poses), BEAM)[0]

    finding = judge_readings((sweeps, *sections), windows, place_poses, engine)
    return finding.status, finding.explanation


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ((1.0, -1.0, -1.0), "the trajectory is mirrored"),
        ((1.0, 1.0, 0.0), "the headings of the trajectory are missing"),
        ((1.0, 1.0, 1.0), ""),
    ],
)
def test_a_mirror_and_missing_headings_are_named(change: tuple[float, float, float], said: str) -> None:
    status, explanation = judge(lambda poses: poses * np.array(change))
    assert explanation.startswith(said) and (status is VerdictStatus.FAIL) is bool(said)


def test_too_few_windows_that_turn_show_no_mirror_and_are_not_judged() -> None:
    sweeps, engine = place(lambda poses: poses * [1.0, 1.0, 0.0]), LocalEngine(1)
    assert sweeps.track is not None
    straight = replace(sweeps, track=replace(sweeps.track, poses=np.sort(sweeps.track.poses * [1.0, 0.0, 0.0], axis=0)))
    windows = [
        replace(w, torn=True) for w in audit_windows((sweeps, CONFIG.audit, CONFIG.estimator), engine, ignore_progress)
    ]
    finding = judge_readings((straight, CONFIG.audit, CONFIG.estimator), windows, lambda _: sweeps, engine)
    assert not finding.judged and finding.reason.endswith("tears the map; all poses look the same way")
