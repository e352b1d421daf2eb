"""Speeds beyond the capture range of inflation: what the windows cannot measure is found by a wide search."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drives import block_drive, noise, street_drive
from support.laser_drive import cast_beams

from mqslam.auditing import steps
from mqslam.auditing.findings import find_torn_steps
from mqslam.auditing.judge import Audit, audit
from mqslam.auditing.registration import is_of_beams
from mqslam.auditing.sizes import TORN_INFLATION, WINDOW
from mqslam.auditing.speeds import CaptureRange, SpeedCheck, check_speeds, contradicts, find_capture_range, judge_speeds
from mqslam.auditing.sweeps import Sweeps, place_sweeps
from mqslam.auditing.verdict import VerdictStatus
from mqslam.auditing.windows.windows import Undecided
from mqslam.commands.lidar_settings import fit_to_rooms
from mqslam.config import Config
from mqslam.core.scans import Returns, Scan, Scans
from mqslam.core.trajectory import Trajectory
from mqslam.execution.local_engine import HERE
from mqslam.execution.progress import ignore_progress
from mqslam.psi.place import beam_of
from mqslam.report.spots import spot_of_window
from mqslam.results.audit_results import summarise

CONFIG, ROOMS = Config(), fit_to_rooms(Config())
CAPTURE = CaptureRange(window_m=2.5, speed_mps=5.0 / 3.0)


@lru_cache
def judged(factor: float, poses: int | None = None, around_block: bool = False) -> tuple[Audit, Sweeps]:
    """Returns ten seconds of street or a block under a trajectory whose speed is wrong by a factor, with so many poses."""
    recording, scans = block_drive() if around_block else street_drive()
    truth = recording.ground_truth
    kept = np.unique(np.linspace(0, len(truth) - 1, poses or len(truth)).astype(int))
    track = Trajectory(truth.stamps_us[kept], truth.poses[kept] * [factor, factor, 1.0])
    sweeps, _ = place_sweeps(scans, track, beam_of(CONFIG.estimator, 0.0))
    return audit(sweeps, CONFIG, HERE, ignore_progress), sweeps


def check(error_mps: float, sure: bool = True) -> SpeedCheck:
    return SpeedCheck(np.array([error_mps, 0.0, 0.0]), sure)


def test_the_capture_range_is_the_widest_neighbourhood_over_a_window() -> None:
    capture = find_capture_range(0.25, CONFIG.estimator)
    assert capture.window_m == CONFIG.estimator.s_start
    assert capture.speed_mps == pytest.approx(CONFIG.estimator.s_start / (WINDOW * 0.25))


def test_a_true_trajectory_contradicts_no_speed() -> None:
    audited, _ = judged(1.0)
    speeds = [w.speed for w in audited.windows if w.speed is not None and w.speed.sure]
    assert len(speeds) >= 4 and max(speed.error_mps for speed in speeds) < 0.5
    assert not any(w.torn for w in audited.windows)
    assert [f.status for f in audited.tests["speeds"]] == [VerdictStatus.PASS]


@pytest.mark.parametrize("factor", [0.0, 0.1, 2.0])
def test_a_speed_far_beyond_the_capture_range_is_measured_and_fails(factor: float) -> None:
    audited, sweeps = judged(factor)
    assert audited.verdict.status is VerdictStatus.FAIL
    reason = next(reason for reason in audited.verdict.reasons if "contradict the trajectory's speed" in reason)
    assert "a window cannot measure corrections beyond 2.5 m (1.7 m/s), so that inflation means nothing there" in reason
    assert audited.verdict.diagnosis.startswith("the trajectory belongs to another recording, or its clock, its scale")
    assert all(w.torn for w in audited.windows if w.speed is not None and w.speed.sure)
    bent = [w for w in audited.windows if w.torn and not w.by_speed]
    assert all(w.bend.inflation > TORN_INFLATION and w.bend.size_m > CONFIG.audit.bend_m for w in bent)
    words = "torn only because the scans contradict its speed."
    assert all(spot_of_window(w).text.endswith(words) is w.by_speed for w in audited.windows)
    errors = [w.speed.error_mps for w in audited.windows if w.speed is not None and w.speed.sure]
    truth = street_drive()[0].ground_truth
    middles = [(w.begin + w.end) // 2 - 1 for w in audited.windows if w.speed is not None and w.speed.sure]
    lengths = np.hypot(*np.diff(truth.at(street_drive()[1].stamps_us)[:, :2], axis=0).T)[middles]
    assert errors == pytest.approx(abs(1.0 - factor) * lengths / sweeps.revolution_s, abs=0.4)
    summary = summarise(audited, sweeps, CONFIG, {}, "given")
    assert summary["speeds"]["contradicted"] == summary["speeds"]["sure"] == len(errors)
    assert summary["speeds"]["capture_m"] == 2.5 and summary["speeds"]["searched_mps"] == 50.0


def test_two_poses_ten_times_too_slow_fail_and_the_words_say_that_inflation_means_nothing() -> None:
    audited, sweeps = judged(0.1, poses=2)
    assert audited.verdict.status is VerdictStatus.FAIL
    assert "the scans contradict the trajectory's speed" in audited.verdict.reasons[0]
    assert any(
        reason.startswith("the trajectory is too sparse to be judged from 0.0 s on") for reason in audited.verdict.reasons
    )
    assert all(w.undecided is Undecided.GAP and not w.torn for w in audited.windows)
    summary = summarise(audited, sweeps, CONFIG, {}, "given")
    assert {row["torn"] for row in summary["per_window"]} == {None}
    assert summary["windows"]["undecided"] == summary["windows"]["count"] and summary["windows"]["torn"] == 0


def test_a_sparse_trajectory_that_is_right_is_not_judged() -> None:
    audited, _ = judged(1.0, poses=5)
    assert audited.verdict.status is VerdictStatus.NOT_JUDGED, audited.verdict.reasons
    assert "too sparse to be judged" in audited.verdict.reasons[0]
    assert audited.verdict.reasons[0].endswith("; give the trajectory with a pose for every scan")


@pytest.mark.parametrize(("factor", "status"), [(1.0, VerdictStatus.NOT_JUDGED), (0.1, VerdictStatus.FAIL)])
def test_poses_eleven_seconds_apart_around_corners_are_judged_by_how_far_they_are_apart(
    factor: float, status: VerdictStatus
) -> None:
    audited, _ = judged(factor, poses=6, around_block=True)
    assert audited.verdict.status is status, audited.verdict.reasons
    assert any(
        reason.startswith("the trajectory is too sparse to be judged from 0.0 s on") for reason in audited.verdict.reasons
    )
    known = [w.speed for w in audited.windows if w.speed is not None and w.speed.sure]
    assert any(contradicts(speed, audited.capture) for speed in known) is (factor != 1.0)
    assert not any(revisit.sure for revisit in audited.revisits)  # where it is back is interpolated, too


def test_a_wrong_speed_beside_a_gap_of_right_poses_is_still_contradicted() -> None:
    recording, scans = street_drive()
    truth = recording.ground_truth
    times = truth.seconds(int(truth.stamps_us[0]))
    poses = truth.poses.copy()
    poses[times < 6.0, :2] *= 2.0  # twice as fast, until a gap whose ends are apart as they should be
    poses[times >= 6.0, :2] += poses[times < 6.0, :2][-1] - truth.poses[times < 6.0, :2][-1]
    kept = (times < 6.0) | (times > 9.0)
    track = Trajectory(truth.stamps_us[kept], poses[kept])
    sweeps, _ = place_sweeps(scans, track, beam_of(CONFIG.estimator, 0.0))
    audited = audit(sweeps, CONFIG, HERE, ignore_progress)
    assert [f.status for f in audited.tests["speeds"]] == [VerdictStatus.FAIL]
    assert audited.verdict.status is VerdictStatus.FAIL


def test_speeds_need_evidence() -> None:
    assert judge_speeds([None, check(9.0, sure=False)], CAPTURE) == []
    fine = [check(0.1)] * 99
    for checks, status in (
        ([*fine, check(9.0)], VerdictStatus.PASS),  # one place of a hundred may only look alike
        ([*fine[:89], *[check(9.0)] * 11], VerdictStatus.WARN),
        ([check(9.0)] * 5, VerdictStatus.FAIL),
        ([check(1.0)] * 5, VerdictStatus.PASS),  # windows can measure that
    ):
        (finding,) = judge_speeds(checks, CAPTURE)
        assert finding.status is status, finding.reason
        assert ("another recording" in finding.explanation) is (
            status is VerdictStatus.FAIL
        )  # where most places contradict it
    (finding,) = judge_speeds([check(9.0)] * 5, CAPTURE, is_of_run=True)  # a run's stamps are the recording's own
    assert (
        finding.explanation.startswith("the front end measured most motions wrongly: ")
        and "clock" not in finding.explanation
    )


def test_scans_half_of_which_are_noise_still_tell_a_wrong_speed() -> None:
    recording, scans = street_drive()
    truth = recording.ground_truth
    noisy = []
    for k, scan in enumerate(scans):
        parts = scan.returns, noise(scan, len(scan.returns), seed=k).returns
        both = np.hstack([[getattr(part, f.name) for f in fields(Returns)] for part in parts])  # the third are times
        noisy.append(replace(scan, returns=Returns(*both[:, np.argsort(both[2], kind="stable")])))
    track = Trajectory(truth.stamps_us, truth.poses * [0.1, 0.1, 1.0])
    sweeps, _ = place_sweeps(replace(scans, scans=tuple(noisy)), track, beam_of(CONFIG.estimator, 0.0))
    checks = check_speeds(
        (sweeps, CONFIG.audit, CONFIG.estimator), range(2, 38, 6), np.ones(len(sweeps), bool), HERE, ignore_progress
    )
    assert all(contradicts(found, CAPTURE) for found in checks)


def build_corridor(*, has_pillars: bool) -> NDArray[np.float64]:
    """Returns the walls (W, 4) of a corridor from x, y to x, y [m], with or without pillars on alternating sides."""
    sides = [[-30.0, y, 70.0, y] for y in (-1.3, 1.4)]
    pillars = [[x, side * 1.3, x, side * 1.0] for x, side in zip(np.arange(2.0, 40.0, 1.7), [1, -1] * 12, strict=False)]
    return np.array([*sides, *(pillars if has_pillars else [])])


def corridor_sweeps(factor: float, walls: NDArray[np.float64]) -> Sweeps:
    """Returns 20 scans of a lidar that drives along a corridor, under a trajectory whose speed is wrong by a factor."""
    poses = np.column_stack([10.0 + 0.22 * np.arange(20), np.full(20, 0.1), np.zeros(20)])
    angles, random = np.linspace(-np.pi / 2, np.pi / 2, 180), np.random.default_rng(4)
    period_us = 860_000
    scans = []
    for k, pose in enumerate(poses):
        ranges = cast_beams(walls, pose[:2], angles, 80.0) + random.normal(0.0, 0.01, len(angles))
        t0, seen = 1e-6 * period_us * k, ranges < 70.0
        returns = Returns(ranges[seen], angles[seen], np.full(int(seen.sum()), t0), np.ones(int(seen.sum())))
        scans.append(Scan(t0, t0 + 0.01, returns))
    track = Trajectory(period_us * np.arange(20), poses * [factor, 1.0, 1.0])
    made = Scans(tuple(scans), 0, 1e-6 * period_us, unit_m=1.0)
    return place_sweeps(made, track, beam_of(ROOMS.estimator, 0.0))[0]


@pytest.mark.parametrize(("factor", "has_pillars", "is_wrong"), [(1.0, False, False), (1.0, True, False), (4.0, True, True)])
def test_the_beams_of_a_lidar_on_bare_walls_contradict_no_speed(factor: float, has_pillars: bool, is_wrong: bool) -> None:
    sweeps = corridor_sweeps(factor, build_corridor(has_pillars=has_pillars))
    shared = sweeps, ROOMS.audit, ROOMS.estimator
    checks = check_speeds(shared, range(2, 18, 3), np.ones(len(sweeps), bool), HERE, ignore_progress)
    capture = find_capture_range(sweeps.revolution_s, ROOMS.estimator)
    assert all(contradicts(found, capture) is is_wrong for found in checks)
    unmarked = replace(sweeps, is_of_lidar=False), ROOMS.audit, ROOMS.estimator
    found = check_speeds(unmarked, range(2, 18, 3), np.ones(len(sweeps), bool), HERE, ignore_progress)
    assert any(contradicts(check, capture) for check in found) is (is_wrong or not has_pillars)


def test_the_beams_of_a_lidar_on_bare_walls_make_no_jump() -> None:
    sweeps = corridor_sweeps(1.0, build_corridor(has_pillars=False))
    for made, is_jump in ((sweeps, False), (replace(sweeps, is_of_lidar=False), True)):
        shared = made, ROOMS.audit, ROOMS.estimator
        fits_as_if_at_rest = steps._register_step(shared, (10, (2.0, 0.2)))
        assert fits_as_if_at_rest is not None and fits_as_if_at_rest.unrivalled
        step = steps._judge_step(fits_as_if_at_rest, 1e-9, shared, 1e-3)
        assert (find_torn_steps([step], ROOMS.audit, ROOMS.verdict) == [step]) is is_jump


@pytest.mark.parametrize("has_pillars", [False, True])
def test_a_fit_some_scans_farther_back_comes_from_the_beams_on_bare_walls_and_from_nothing_else(has_pillars: bool) -> None:
    """Scans that are moved back by one or two steps overlay earlier ones on bare walls; pillars show a wrong trajectory."""
    sweeps = corridor_sweeps(1.0, build_corridor(has_pillars=has_pillars))
    for place in range(5, 16):
        true = steps._register_step((sweeps, ROOMS.audit, ROOMS.estimator), (place, (2.0, 0.2)))
        assert true is not None
        for back in (np.array([-0.22, 0.0, 0.0]), np.array([-0.44, 0.0, 0.0])):
            moved = replace(true, between=true.between + back, offset=-back) if has_pillars else replace(true, offset=back)
            assert is_of_beams(moved, steps.pick_sides(place), sweeps, ROOMS.estimator) is not has_pillars
