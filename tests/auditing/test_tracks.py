"""The trajectory itself: its gaps, its jumps, and scans that it does not cover."""

from __future__ import annotations

import numpy as np
import pytest

from mqslam.auditing.sizes import WINDOW
from mqslam.auditing.tracks import (
    Track,
    find_jumps,
    judge_cover,
    judge_doubt,
    judge_track,
    mark_interpolated,
    measure_doubt,
    state_cover,
)
from mqslam.auditing.verdict import Finding, VerdictStatus
from mqslam.config import Config
from mqslam.core import se2

CONFIG = Config()
REVOLUTION_S = 0.25
WINDOW_S = WINDOW * REVOLUTION_S
TIMES = REVOLUTION_S * np.arange(160)  # 40 s


def driven(times: np.ndarray) -> np.ndarray:
    """Returns the poses (N, 3) of a drive that speeds up, turns and brakes, as hard as a car does."""
    speed = 8.0 + 4.0 * np.sin(times / 2.0)
    yaw = 0.5 * np.sin(times / 3.0)
    x, y = (np.cumsum(speed * turn(yaw)) * np.gradient(times) for turn in (np.cos, np.sin))
    return np.column_stack([x, y, yaw])


def track(keep: np.ndarray | None = None, noise_m: float = 0.0) -> Track:
    """Returns the track of the drive with a pose per scan, or with those that are kept."""
    poses = driven(TIMES) + noise_m * np.random.default_rng(1).normal(size=(len(TIMES), 3)) * [1.0, 1.0, 0.02]
    kept = np.ones(len(TIMES), dtype=bool) if keep is None else keep
    return Track(TIMES[kept], poses[kept], len(TIMES), 0)


def judged(given: Track) -> list[Finding]:
    return judge_track(given, TIMES, REVOLUTION_S, CONFIG.audit)


@pytest.mark.parametrize(("uncovered", "warns"), [(0, 0), (16, 0), (17, 1), (60, 1), (80, 1), (81, 1)])
def test_a_trajectory_of_a_part_of_the_scans_is_a_warning_of_its_own(uncovered: int, warns: int) -> None:
    part = Track(TIMES[uncovered:], driven(TIMES)[uncovered:], 160, uncovered)
    findings = judge_cover(part)
    assert [finding.status for finding in findings] == [VerdictStatus.WARN] * warns
    separator = "," if uncovered > 80 else ""  # then the sentence is about stamps that may not fit
    named = f"{160 - uncovered} of 160 scans{separator} from {TIMES[uncovered]:.1f} s to 39.8 s"
    assert all(named in finding.reason for finding in findings)
    assert all(finding.reason.endswith("fit the recording's") is (uncovered > 80) for finding in findings)
    assert judge_track(part, TIMES[uncovered:], REVOLUTION_S, CONFIG.audit) == []


def test_of_a_trajectory_that_lacks_a_few_scans_it_is_said_where_they_lie() -> None:
    whole, most = (state_cover(Track(TIMES[k:], driven(TIMES)[k:], 160, k)).reason for k in (0, 1))
    assert whole == "the trajectory covers 160 of 160 scans; its poses alone show no gap and no jump"
    assert "covers 159 of 160 scans, and the rest lies before its first pose or after its last; its poses" in most


@pytest.mark.parametrize("noise_m", [0.0, 0.02, 0.3])
def test_nothing_is_said_of_a_dense_trajectory(noise_m: float) -> None:
    assert judged(track(noise_m=noise_m)) == []


def test_a_gap_is_a_warning_that_says_from_when_to_when() -> None:
    (finding,) = judged(track((TIMES <= 10.0) | (TIMES >= 15.0)))
    assert finding.status is VerdictStatus.WARN
    assert finding.reason.startswith("the trajectory has a gap from 10.0 s to 15.0 s: its poses are farther apart than a ")
    assert "left undecided" in finding.reason


def test_poses_a_window_apart_are_no_gap_and_farther_ones_are_one_stretch() -> None:
    assert judged(track(np.arange(160) % 6 == 0)) == []  # 1.5 s apart, the length of a window
    (finding,) = judged(track((TIMES <= 20.0) | (TIMES % 2.0 == 0.0)))
    assert finding.status is VerdictStatus.WARN and "from 20.0 s to 38.0 s" in finding.reason
    (finding,) = judged(track((TIMES <= 6.0) | (TIMES % 2.0 == 0.0) | (np.arange(160) == 159)))
    assert finding.status is VerdictStatus.NOT_JUDGED
    assert finding.reason.startswith("the trajectory is too sparse to be judged from 6.0 s on (")


def test_scans_beside_a_pose_are_not_interpolated_and_a_gap_of_the_recording_itself_is_no_gap() -> None:
    given = track((TIMES <= 10.0) | (TIMES >= 15.0))
    marked = mark_interpolated(given, TIMES, REVOLUTION_S)
    np.testing.assert_array_equal(TIMES[marked], TIMES[(TIMES > 10.0) & (TIMES < 15.0)])
    assert not mark_interpolated(given, given.times, REVOLUTION_S).any()


@pytest.mark.parametrize("noise_m", [0.0, 0.02])
def test_a_jump_is_found_where_it_is_and_measured(noise_m: float) -> None:
    given = track(noise_m=noise_m)
    given.poses[80:, :2] += [3.0, 4.0]
    (jump,) = find_jumps(given, WINDOW_S, CONFIG.audit)
    assert (jump.t0, jump.t1) == (TIMES[79], TIMES[80])
    assert jump.distance_m == pytest.approx(5.0, abs=0.3)
    (finding,) = judged(given)
    assert finding.status is VerdictStatus.WARN and "jumps at 19.8 s by " in finding.reason


@pytest.mark.parametrize(("steps", "is_shared"), [([80], True), ([80, 120], True), ([120], False), ([], False)])
def test_it_is_said_if_odometry_jumps_where_the_trajectory_does(steps: list[int], is_shared: bool) -> None:
    given, odometry = track(), driven(TIMES)
    given.poses[80:, :2] += [3.0, 4.0]
    for step in steps:
        odometry[step:, :2] += 4.0
    (finding,) = judge_track(given, TIMES, REVOLUTION_S, CONFIG.audit, odometry)
    assert finding.reason.endswith("; the odometry jumps there, too") is is_shared
    assert finding.explanation == finding.reason


def test_a_pose_that_is_wrong_alone_is_a_jump_there_and_one_back() -> None:
    given = track()
    given.poses[80, :2] += 4.0
    assert [jump.t0 for jump in find_jumps(given, WINDOW_S, CONFIG.audit)] == [TIMES[79], TIMES[80]]


def test_a_jump_in_yaw_is_found() -> None:
    given = track()
    given.poses[80:, 2] += 1.0
    (jump,) = find_jumps(given, WINDOW_S, CONFIG.audit)
    assert jump.t1 == TIMES[80] and jump.angle_rad == pytest.approx(1.0, abs=0.1)


def test_what_a_vehicle_can_do_is_no_jump() -> None:
    given = track()
    given.poses[80:, :2] += [0.4, 0.0]  # within the tolerance of a torn revisit
    assert find_jumps(given, WINDOW_S, CONFIG.audit) == []
    speeds = np.concatenate([np.full(80, 10.0), np.arange(8.0, 0.0, -2.0), np.zeros(76)])  # an emergency stop, 8 m/s^2
    poses = np.column_stack([REVOLUTION_S * np.cumsum(speeds), 0.0 * TIMES, 0.0 * TIMES])
    assert find_jumps(Track(TIMES, poses, 160, 0), WINDOW_S, CONFIG.audit) == []


def test_steps_of_a_trajectory_that_jumps_all_the_time_are_its_noise() -> None:
    assert find_jumps(track(noise_m=3.0), WINDOW_S, CONFIG.audit) == []


def test_a_step_over_a_gap_is_no_jump() -> None:
    given = track((TIMES <= 10.0) | (TIMES >= 15.0))
    given.poses[given.times >= 15.0, :2] += 100.0
    assert find_jumps(given, WINDOW_S, CONFIG.audit) == []


def test_a_trajectory_of_less_than_a_window_judges_nothing() -> None:
    few = Track(TIMES[:3], driven(TIMES)[:3], 160, 157)
    (finding,) = judge_cover(few)
    assert finding.status is VerdictStatus.NOT_JUDGED and "covers only 3 of 160 scans" in finding.reason


def test_a_trajectory_of_few_scans_is_a_warning_about_its_stamps() -> None:
    few = Track(TIMES[:60], driven(TIMES)[:60], 160, 100)
    (finding,) = judge_cover(few)
    assert finding.status is VerdictStatus.WARN
    assert finding.reason.startswith("the trajectory covers only 60 of 160 scans, from 0.0 s to 14.8 s")
    assert judge_track(Track(TIMES, driven(TIMES), 160, 60), TIMES, REVOLUTION_S, CONFIG.audit) == []


@pytest.mark.parametrize("every", [2, 4, 6])
def test_the_doubt_of_sparse_poses_covers_what_interpolation_is_off_by(every: int) -> None:
    sparse = track(np.arange(160) % every == 0)
    times = TIMES[: 160 - every]
    doubt_m = measure_doubt(sparse, times, REVOLUTION_S, 30.0)
    off = se2.wrapped_between(driven(TIMES)[: len(times)], se2.smooth(sparse.times, sparse.poses, times))
    off_m = np.hypot(off[:, 0], off[:, 1]) + 30.0 * np.abs(off[:, 2])
    assert np.all(off_m <= doubt_m) and doubt_m.max() < 0.2 * every
    (finding,) = judge_doubt(doubt_m, CONFIG.audit)
    assert not finding.judged and f"by up to {doubt_m.max():.2f} m" in finding.reason


def test_no_doubt_is_cast_on_poses_of_every_scan_nor_on_a_straight_drive() -> None:
    assert not measure_doubt(track(noise_m=0.3), TIMES, REVOLUTION_S, 30.0).any()
    straight = np.column_stack([8.0 * TIMES[::8], 0.0 * TIMES[::8], 0.0 * TIMES[::8]])
    assert np.allclose(measure_doubt(Track(TIMES[::8], straight, 160, 0), TIMES, REVOLUTION_S, 30.0), 0.0)
    assert judge_doubt(np.zeros(160), CONFIG.audit) == []
